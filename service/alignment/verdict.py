"""The verdict: aligned, or which way to move, or why that cannot be said and what would help."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from service.alignment.bands import Bands, Grade, graded, too_large
from service.vision.measurement import Doubt, Lock, TubeState

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.alignment.entry import Entry
    from service.alignment.geometry import Lean
    from service.vision.measurement import Measurement, Pose

__all__ = ["NOT_POINTING", "Help", "Judgement", "Sight", "Verdict", "judge", "picture_axes"]

NOT_POINTING = "the guide, as it is set up, does not point at the sheet"
WORTH_TELLING_MM = 0.05
LOST_BESIDE = 0.03
UNSURE_FOCAL_LENGTH = 0.01
"""A focal length less sure than this is what a wide sigma comes from."""


class Verdict(enum.StrEnum):
    """What the operator is told."""

    ALIGNED = "aligned"
    ADJUST = "adjust"
    CANNOT_JUDGE = "cannot judge"
    NO_LOCK = "no lock"
    STALE = "stale"


class Help(enum.StrEnum):
    """What would make a judgement possible."""

    ZOOM_IN = "zoom in"
    LIGHT = "more light"
    FOCUS = "focus"
    CALIBRATE = "calibrate the camera"
    ALIGN_SETUP = "measure the guide again: bowlsight align-setup"
    PITCH = "give the pitch more exactly"
    ANCHOR = "anchor a tube"
    INDEX = "move back to where the index was certain, or anchor a tube"
    TARGET = "choose the target again"
    SOURCE = "check the video source"


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What a judgement rests on.

    Attributes
    ----------
    measurement
        Vision's answer.
    stale
        Whether it is too old, or its picture the same one for too long.
    obstacle
        Why the target cannot be said, with what would help; None where there is one.
    state
        What stands at the target's place.
    lean, entry
        The geometry; None without a lock or a target.
    """

    measurement: Measurement
    stale: bool = False
    obstacle: tuple[str, Help] | None = None
    state: TubeState = TubeState.UNKNOWN
    lean: Lean | None = None
    entry: Entry | None = None


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict and what it is made of.

    Attributes
    ----------
    verdict, reasons, helps
        In words: the verdict, why, and what would help.
    advice, advice_sheet
        How to move the guide: in the picture's directions, and in the sheet's axes.
    offset_grade, tilt_grade, entry_grade
        Which bands the figures are in; None where they were not judged.
    unsure
        Whether a sigma was too large.
    """

    verdict: Verdict
    reasons: tuple[str, ...] = ()
    helps: tuple[Help, ...] = ()
    advice: str = ""
    advice_sheet: str = ""
    offset_grade: Grade | None = None
    tilt_grade: Grade | None = None
    entry_grade: Grade | None = None
    unsure: bool = False

    @property
    def grade(self) -> Grade | None:
        """The worst of the grades; None where nothing was judged."""
        return max((g for g in (self.offset_grade, self.tilt_grade, self.entry_grade) if g is not None), default=None)


def judge(sight: Sight, bands: Bands, before: Judgement | None) -> Judgement:
    """Judge one picture; `before` is the last judgement of the same target, for hysteresis."""
    m = sight.measurement
    if sight.stale:
        return Judgement(Verdict.STALE, ("the picture does not change any more",), (Help.SOURCE,))
    if m.lock is Lock.NONE or m.pose is None:
        return Judgement(Verdict.NO_LOCK, (m.reason or "no tube pattern is seen",), _helps_of(m.doubt) or (Help.LIGHT,))
    if sight.obstacle is not None:
        return Judgement(Verdict.CANNOT_JUDGE, (sight.obstacle[0],), (sight.obstacle[1],))
    if sight.lean is None or sight.entry is None:
        return Judgement(Verdict.CANNOT_JUDGE, (NOT_POINTING,), (Help.ALIGN_SETUP,))
    unsure = _unsure(sight, m.pose, sight.lean, bands, before)
    return unsure or _graded(sight, m.pose, sight.lean, sight.entry, bands, before)


FORBIDDING = {Doubt.INDEX: Help.INDEX, Doubt.SCALE: Help.CALIBRATE, Doubt.CALIBRATION: Help.CALIBRATE}
HINTING = {Doubt.FOCUS: Help.FOCUS, Doubt.LIGHT: Help.LIGHT}


def _helps_of(doubt: tuple[Doubt, ...]) -> tuple[Help, ...]:
    return tuple(dict.fromkeys((FORBIDDING | HINTING)[d] for d in doubt))


def _unsure(sight: Sight, pose: Pose, lean: Lean, bands: Bands, before: Judgement | None) -> Judgement | None:
    """The judgement that none can be made; None where one can."""
    doubt = sight.measurement.doubt
    if forbidding := [d for d in doubt if d in FORBIDDING]:
        return Judgement(Verdict.CANNOT_JUDGE, tuple(f"{d} is in doubt" for d in forbidding), _helps_of(doubt))
    was = before is not None and before.unsure
    reasons: list[str] = []
    blocks = []
    if too_large(lean.offset_sigma_mm, bands.offset_sigma_mm, before=was):
        reasons.append(f"offset is uncertain by {lean.offset_sigma_mm:.2f} mm, above {bands.offset_sigma_mm:g}")
        blocks.append(slice(0, 2))
    if too_large(lean.tilt_sigma_deg, bands.tilt_sigma_deg, before=was):
        reasons.append(f"tilt is uncertain by {lean.tilt_sigma_deg:.2f} deg, above {bands.tilt_sigma_deg:g}")
        blocks.append(slice(2, 4))
    if not reasons:
        return None
    helps = dict.fromkeys(_help_for(sight.measurement, pose, lean, block) for block in blocks)
    return Judgement(Verdict.CANNOT_JUDGE, tuple(reasons), tuple(helps), unsure=True)


def _help_for(m: Measurement, pose: Pose, lean: Lean, block: slice) -> Help:
    """What most of a too large sigma comes from says what would help."""
    share = {name: float(np.trace(part[block, block])) for name, part in lean.parts.items()}
    source = max(share, key=lambda name: share[name])
    if source in ("guide", "pitch"):
        return Help.ALIGN_SETUP if source == "guide" else Help.PITCH
    if pose.sigma.focal_length_mm > UNSURE_FOCAL_LENGTH * (pose.camera.focal_length_mm or math.inf):
        return Help.CALIBRATE
    return next((HINTING[d] for d in m.doubt if d in HINTING), Help.ZOOM_IN)


def _graded(sight: Sight, pose: Pose, lean: Lean, entry: Entry, bands: Bands, before: Judgement | None) -> Judgement:
    """Grade offset, tilt and entry."""
    b = before or Judgement(Verdict.CANNOT_JUDGE)
    offset = graded(
        lean.distance_mm, bands.offset_normal_mm, bands.offset_advisory_mm, bands.offset_hysteresis_mm, b.offset_grade
    )
    tilt = graded(
        lean.tilt_deg, bands.tilt_normal_deg, bands.tilt_advisory_deg, bands.tilt_hysteresis_deg, b.tilt_grade
    )
    reserve = bands.margin_sigmas * entry.margin_sigma_mm
    touches = graded(-entry.margin_mm, -reserve, 0.0, bands.offset_hysteresis_mm, b.entry_grade)
    reasons = [
        f"offset is {lean.distance_mm:.2f} mm, band {bands.offset_normal_mm:g}" if offset else "",
        f"tilt is {lean.tilt_deg:.2f} deg, band {bands.tilt_normal_deg:g}" if tilt else "",
        _entry_reason(touches, entry),
    ]
    blocked = _BLOCKED.get(sight.state)
    if blocked is not None:
        reasons, touches = [blocked, *reasons], Grade.ALARM
    if not any(reasons):
        return Judgement(Verdict.ALIGNED, offset_grade=offset, tilt_grade=tilt, entry_grade=touches)
    way, sheet_way = _ways(pose, lean, bands)
    return Judgement(
        Verdict.ADJUST,
        tuple(r for r in reasons if r),
        (Help.TARGET,) if blocked is not None else (),
        way if blocked is None else "choose another tube",
        sheet_way if blocked is None else "",
        offset,
        tilt,
        touches,
    )


_BLOCKED = {TubeState.PLUGGED: "the target tube is plugged", TubeState.ABSENT: "no tube is seen at the target"}


def _entry_reason(grade: Grade, entry: Entry) -> str:
    if grade is Grade.NORMAL:
        return ""
    would = "would" if grade is Grade.ALARM else "might"
    return f"the probe {would} touch: margin {entry.margin_mm:+.2f} ± {entry.margin_sigma_mm:.2f} mm"


def picture_axes(pose: Pose) -> NDArray[np.float64]:
    """Unit vectors in the sheet's plane, rows of (2, 2), that run to the right and downwards in the picture."""
    right = pose.rotation[0, :2] / np.hypot(*pose.rotation[0, :2])
    return np.array([right, [-right[1], right[0]]])


def _ways(pose: Pose, lean: Lean, bands: Bands) -> tuple[str, str]:
    """How to move the guide, in the picture and in the sheet's axes."""
    x, y = -lean.offset_mm
    parts, sheet = [], []
    if lean.distance_mm > WORTH_TELLING_MM:
        parts.append(_way(picture_axes(pose) @ -lean.offset_mm, max(lean.offset_sigma_mm, WORTH_TELLING_MM), "mm"))
        sheet.append(f"X {x:+.2f} mm, Y {y:+.2f} mm")
    if lean.tilt_deg > bands.tilt_normal_deg - bands.tilt_hysteresis_deg:
        turn = np.degrees(np.arctan(-lean.slope))
        parts.append("point " + _way(picture_axes(pose) @ turn, max(lean.tilt_sigma_deg, 0.05), "deg"))
        sheet.append(f"point X {turn[0]:+.2f} deg, Y {turn[1]:+.2f} deg")
    return "; ".join(parts), "; ".join(sheet)


def _way(right_down: NDArray[np.float64], least: float, unit: str) -> str:
    """Directions in words, the larger first; the smaller only where it is above `least` and not lost beside it."""
    words = [("right", "left"), ("down", "up")]
    order = np.argsort(-np.abs(right_down), kind="stable")
    said = [
        f"{words[i][int(right_down[i] < 0)]} {_figure(abs(float(right_down[i])))} {unit}"
        for k, i in enumerate(order.tolist())
        if k == 0 or abs(right_down[i]) >= max(least, LOST_BESIDE * float(np.abs(right_down).max()))
    ]
    return ", ".join(said)


def _figure(value: float) -> str:
    return f"{value:.2f}" if value < 1 else f"{value:.1f}" if value < 10 else f"{value:.0f}"
