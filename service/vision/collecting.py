"""Collect pictures for a calibration while others measure them: which are kept, and why the rest is not."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from service.vision.keyframes import MOST, Keyframe, Keyframes
from service.vision.measurement import Doubt
from service.vision.selfcalibration import LEAST_TUBES, Calibration, calibrate

if TYPE_CHECKING:
    from service.vision.bundle import Range
    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement

__all__ = ["Collector"]


class Collector:
    """Keeps the pictures that tell most of a camera, and solves for it.

    Parameters
    ----------
    camera
        The full frame's camera, as far as it is known.
    most
        Pictures kept.
    """

    def __init__(self, camera: Camera, lattice: Lattice, most: int = MOST) -> None:
        self.camera, self.lattice = camera, lattice
        self.kept = Keyframes(most)
        self.seen = 0
        """Pictures looked at."""
        self.left_out: Counter[str] = Counter()
        """Why pictures said nothing of the camera, and how many of them."""
        self._series = self._source = 0

    def begin(self) -> None:
        """Go on with pictures of another source: their lattice index has nothing to do with the one before."""
        self._series += 1
        self._source = self._series

    def take(self, measurement: Measurement) -> bool:
        """Look at a measured picture; whether it was kept."""
        self.seen += 1
        reason = _useless(measurement)
        if reason is not None:
            self.left_out[reason] += 1
            return False
        series = self._source
        if Doubt.INDEX in measurement.doubt:  # its tubes may be others than they are taken for
            self._series += 1
            series = self._series
        return self.kept.add(Keyframe.of(measurement, self.lattice, series))

    def solve(self, known_range: Range | None = None) -> Calibration:
        """The camera that the pictures kept tell of; raises DegenerateError where there is none."""
        return calibrate(list(self.kept), self.camera, self.lattice, known_range)


def _useless(m: Measurement) -> str | None:
    """Why a picture says nothing of the camera; None where it does."""
    if m.pose is None or m.view is None:
        return f"no lock: {m.reason}"
    if Doubt.FOCUS in m.doubt:
        return "out of focus"
    if m.view.measured.sum() < LEAST_TUBES:
        return f"fewer than {LEAST_TUBES} tubes measured"
    return None
