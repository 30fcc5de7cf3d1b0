"""The bands of the plant, and how a value passes from one to the next."""

from __future__ import annotations

import enum
from dataclasses import dataclass

__all__ = ["Bands", "Grade", "graded", "too_large"]


class Grade(enum.IntEnum):
    """How good: NORMAL within the band, ADVISORY beyond it, ALARM beyond that."""

    NORMAL = 0
    ADVISORY = 1
    ALARM = 2


@dataclass(frozen=True, slots=True)
class Bands:
    """Limits of [alignment.bands]; a value is in its band up to and with the limit.

    The hystereses are what a value must fall below a limit by before it counts as better again. Where a sigma is beyond
    its own limit, nothing is judged.
    """

    offset_normal_mm: float = 0.25
    offset_advisory_mm: float = 0.5
    offset_hysteresis_mm: float = 0.05
    offset_sigma_mm: float = 0.2
    tilt_normal_deg: float = 0.5
    tilt_advisory_deg: float = 1.0
    tilt_hysteresis_deg: float = 0.1
    tilt_sigma_deg: float = 0.25
    parallelism_normal_deg: float = 0.1
    margin_sigmas: float = 2.0


def graded(value: float, normal: float, advisory: float, hysteresis: float, before: Grade | None) -> Grade:
    """The grade of a value: worse at once, better only once it is so by the hysteresis."""
    now = _plain(value, normal, advisory)
    return now if before is None else max(now, min(before, _plain(value + hysteresis, normal, advisory)))


def _plain(value: float, normal: float, advisory: float) -> Grade:
    if value <= normal:
        return Grade.NORMAL
    return Grade.ADVISORY if value <= advisory else Grade.ALARM


def too_large(sigma: float, limit: float, *, before: bool) -> bool:
    """Whether a sigma forbids a judgement; once it did, until it is a tenth below the limit. NaN does."""
    return not sigma <= (0.9 * limit if before else limit)
