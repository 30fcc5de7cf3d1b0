"""Each measurement held against what lens and range finder say at that moment."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, Final

from service.acquisition.readings import Calibration
from service.alignment.consistency import LatticeStatement, Source, Verdict, check_consistency
from service.alignment.priors import Prior, Priors
from service.vision.measurement import Doubt, Lock

if TYPE_CHECKING:
    from collections.abc import Callable

    from service.acquisition.readings import InstrumentReadings
    from service.alignment.consistency import Consistency
    from service.vision.measurement import Measurement

__all__ = ["CrossCheck", "doubted", "priors_of"]

HOLD_S: Final = 1.0
"""How long a verdict must last to be told: a single picture proves little."""


def priors_of(readings: InstrumentReadings, measurement: Measurement) -> Priors:
    """What the instruments say, and whether that goes with a measurement."""
    r, pose = readings, measurement.pose
    distance = Prior(r.distance_mm, r.distance_sigma_mm, r.distance_age_s, r.distance_reason)
    focal_length = Prior(r.focal_length_mm, r.focal_sigma_mm, r.lens_age_s, r.focal_reason)
    lattice = None if pose is None else LatticeStatement.of(pose)
    return Priors(
        distance=distance,
        focal_length=focal_length,
        zoom_position=r.zoom_position,
        focus_position=r.focus_position,
        lens_moving=r.lens_moving,
        calibration=str(r.calibration),
        calibration_reason=r.calibration_reason,
        consistency=check_consistency(lattice, focal_length.pair, distance.pair),
    )


def doubted(measurement: Measurement, priors: Priors) -> Measurement:
    """A measurement, with the doubts that the instruments cast on it.

    A lens that moved off takes the calibration with it; where lens and range finder agree that the lattice's distance
    is wrong, its scale is.
    """
    doubts = set(measurement.doubt)
    if priors.calibration == Calibration.STALE:
        doubts.add(Doubt.CALIBRATION)
    if priors.consistency.odd is Source.LATTICE:
        doubts.add(Doubt.SCALE)
    if measurement.lock is Lock.NONE or doubts == set(measurement.doubt):
        return measurement
    return replace(measurement, lock=Lock.PARTIAL, doubt=tuple(d for d in Doubt if d in doubts))


class CrossCheck:
    """Holds measurement after measurement against the instruments, and tells where something begins to disagree.

    Parameters
    ----------
    readings
        Gives what the instruments say now; returns at once.
    tell
        Gets a line of text with INFO or WARN; returns at once.
    """

    def __init__(
        self, readings: Callable[[], InstrumentReadings], tell: Callable[[str, str], None] = lambda *_: None
    ) -> None:
        self._readings, self._tell = readings, tell
        self._told: tuple[object, ...] = (None, None, Calibration.CURRENT)
        self._new: tuple[object, ...] = self._told
        self._since_ns = 0
        self.said: dict[str, Any] = {}
        """What the instruments said with the last measurement, in JSON's own types."""

    def apply(self, measurement: Measurement) -> tuple[Measurement, Priors]:
        """The measurement with the doubts that follow, and what they follow from."""
        readings = self._readings()
        self.said = {"readings": asdict(readings)}
        priors = priors_of(readings, measurement)
        self._watch(priors, measurement.time_ns)
        return doubted(measurement, priors), priors

    def _watch(self, priors: Priors, now_ns: int) -> None:
        c = priors.consistency
        wrong = c if c.verdict in (Verdict.ODD_ONE_OUT, Verdict.DISAGREEMENT) else None
        now = (wrong and wrong.verdict, wrong and wrong.odd, priors.calibration)
        if now != self._new:
            self._new, self._since_ns = now, now_ns
        if now == self._told or now_ns - self._since_ns < HOLD_S * 1e9:
            return
        before, self._told = self._told, now
        if now[:2] != before[:2]:
            self._tell_of_consistency(wrong)
        if now[2] != before[2]:
            self._tell_of_calibration(priors)

    def _tell_of_consistency(self, wrong: Consistency | None) -> None:
        if wrong is None:
            self._tell("lattice, lens and range finder do not contradict each other any more", "INFO")
        else:
            self._tell(wrong.text, "WARN")

    def _tell_of_calibration(self, priors: Priors) -> None:
        good = priors.calibration in (Calibration.CURRENT, Calibration.WITHOUT_LENS)
        reason = f": {priors.calibration_reason}" if priors.calibration_reason else ""
        self._tell(f"the camera's calibration is {priors.calibration}{reason}", "INFO" if good else "WARN")
