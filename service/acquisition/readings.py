"""What lens and range finder say of focal length, distance and calibration, at one moment: pure functions."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from drivers.reading import Quality
from drivers.zoom_table import focal_prior

if TYPE_CHECKING:
    from drivers.lens import LensState
    from drivers.range_finder import RangeReading
    from service.config.instruments import LensSettings, RangeFinderSettings

__all__ = [
    "Calibration",
    "Estimate",
    "InstrumentReadings",
    "LensPlace",
    "calibration_of",
    "distance_of",
    "focal_length_of",
    "is_moving",
    "place_of",
]


class Calibration(enum.StrEnum):
    """Whether the camera's calibration still belongs to the lens.

    CURRENT: the lens stands where it was calibrated. STALE: it moves, or stands elsewhere. UNCONFIRMED: it cannot be
    asked. WITHOUT_LENS: the camera has none that could be asked.
    """

    CURRENT = "current"
    STALE = "stale"
    UNCONFIRMED = "unconfirmed"
    WITHOUT_LENS = "without lens"


class LensPlace(NamedTuple):
    """Where a lens stands, in its own counts; None: no matter where."""

    zoom_position: int
    focus_position: int | None


class Estimate(NamedTuple):
    """A value with its sigma, how old it is, and how far to trust it; GOOD ones only have a value."""

    value: float | None
    sigma: float | None
    age_s: float | None
    quality: Quality
    reason: str | None


@dataclass(frozen=True, slots=True)
class InstrumentReadings:
    """What the instruments say now. A value is None unless its quality is GOOD; `reason` then says why.

    Attributes
    ----------
    distance_mm, distance_sigma_mm
        From the camera's centre to the sheet along the optical axis (not along the sheet's normal).
    distance_age_s
        Since the last good measurement; None where there was none.
    focal_length_mm, focal_sigma_mm
        From the zoom position: a prior that holds for the type of lens.
    zoom_position, focus_position, lens_age_s
        Where the lens stood when it was last heard, in its own counts, and how long ago.
    lens_moving
        Whether zoom or focus are under way; None where the lens does not tell.
    calibration, calibration_reason
        Whether the camera file still belongs to the lens.
    """

    distance_mm: float | None = None
    distance_sigma_mm: float | None = None
    distance_age_s: float | None = None
    distance_quality: Quality = Quality.BAD
    distance_reason: str | None = "no range finder is configured"
    focal_length_mm: float | None = None
    focal_sigma_mm: float | None = None
    zoom_position: int | None = None
    focus_position: int | None = None
    lens_age_s: float | None = None
    focal_quality: Quality = Quality.BAD
    focal_reason: str | None = "no lens is configured"
    lens_moving: bool | None = None
    calibration: Calibration = Calibration.WITHOUT_LENS
    calibration_reason: str | None = None


# -- pure functions of readings and time -------------------------------------------------------------------------------


def distance_of(
    now_ns: int, newest: RangeReading | None, good: RangeReading | None, settings: RangeFinderSettings
) -> Estimate:
    """Distance from the camera's centre, from the last reading and the last good one."""
    age_s = None if good is None else (now_ns - good.time_ns) / 1e9
    if (fault := _fault(newest, age_s, settings.stale_after_s)) is not None:
        return Estimate(None, None, age_s, *fault)
    assert good is not None
    assert good.distance_mm is not None
    distance_mm = good.distance_mm + settings.offset_mm
    if distance_mm <= 0:
        said = f"{good.distance_mm:g} mm with offset_mm = {settings.offset_mm:g} is behind the camera"
        return Estimate(None, None, age_s, Quality.BAD, said)
    return Estimate(distance_mm, good.sigma_mm, age_s, Quality.GOOD, None)


def focal_length_of(
    now_ns: int, newest: LensState | None, good: LensState | None, before: LensState | None, settings: LensSettings
) -> Estimate:
    """Prior on the focal length, from the last reading and the last two good ones."""
    age_s = None if good is None else (now_ns - good.time_ns) / 1e9

    def bad(reason: str) -> Estimate:
        return Estimate(None, None, age_s, Quality.BAD, reason)

    if (fault := _fault(newest, age_s, settings.stale_after_s)) is not None:
        return Estimate(None, None, age_s, *fault)
    assert good is not None
    assert good.zoom_position is not None
    if settings.wide_focal_length_mm is None:
        return bad("wide_focal_length_mm is not configured")
    if is_moving(good, before, settings.tolerance_counts):
        return bad("the lens moves")
    if good.digital_zoom:
        return bad("digital zoom is on: pictures may be enlarged")
    try:
        f_mm, sigma_mm = focal_prior(good.zoom_position, settings.wide_focal_length_mm, settings.zoom_table)
    except ValueError as error:
        return bad(str(error))
    return Estimate(f_mm, sigma_mm, age_s, Quality.GOOD, None)


def _fault(newest: LensState | RangeReading | None, age_s: float | None, limit_s: float) -> tuple[Quality, str] | None:
    """Why a reading is not to be used: never one, the last one bad, or too old."""
    if newest is None:
        return Quality.BAD, "no answer yet"
    if newest.quality is not Quality.GOOD:
        return Quality.BAD, newest.reason or "bad"
    assert age_s is not None
    if age_s > limit_s:
        return Quality.STALE, f"last answer {age_s:.1f} s ago"
    return None


def calibration_of(
    now_ns: int,
    last: LensState | None,
    before: LensState | None,
    calibrated: LensPlace | None,
    settings: LensSettings,
) -> tuple[Calibration, str | None, bool | None]:
    """Whether the calibration still belongs to the lens, why not, and whether the lens moves.

    `last` and `before` are the last two good readings, `calibrated` where the lens stood; None: not known yet. What
    counts is where the lens stands, not what it went through: back at its place, the calibration is current again, as
    exactly as lens positions repeat. A lens last seen elsewhere stays STALE although it is heard no more.
    """
    if last is None:
        return Calibration.UNCONFIRMED, "no answer yet", None
    away = None if calibrated is None else _displacement(last, calibrated, settings.tolerance_counts)
    age_s = (now_ns - last.time_ns) / 1e9
    if age_s > settings.stale_after_s:
        unheard = Calibration.UNCONFIRMED, f"last answer {age_s:.1f} s ago", None
        return (Calibration.STALE, away, None) if away else unheard
    if is_moving(last, before, settings.tolerance_counts):
        return Calibration.STALE, "the lens moves", True
    return (Calibration.STALE, away, False) if away else (Calibration.CURRENT, None, False)


def is_moving(last: LensState, before: LensState | None, tolerance: int) -> bool:
    """Whether a lens moved when it was last heard; where it has no executing bits, by where it stood before."""
    return bool(last.executing) or (before is not None and _displacement(last, place_of(before), tolerance) is not None)


def place_of(state: LensState) -> LensPlace:
    """Where a lens stood that told so."""
    assert state.zoom_position is not None
    return LensPlace(state.zoom_position, state.focus_position)


def _displacement(state: LensState, place: LensPlace, tolerance: int) -> str | None:
    """In words, how a lens stands elsewhere than at `place`; None where it stands there."""
    for what, now, then in zip(("zoom", "focus"), place_of(state), place, strict=True):
        if now is not None and then is not None and abs(now - then) > tolerance:
            return f"{what} stands at {now}, calibrated at {then}: move it back, or calibrate again"
    return None
