"""Whether the source has gone wrong, from times alone: pure functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from service.config.supervision import SupervisionSettings

__all__ = ["Call", "is_hung", "is_stalled", "silence_limit_s"]

SHARE: Final = 0.9
"""Of the time within which a stall is to be noticed, after which it is called one: noticing takes some of it."""


class Call(NamedTuple):
    """A call of the driver under way: what it does, since when, and how long it may take by what it was asked."""

    doing: str
    since_ns: int
    allowed_s: float


def silence_limit_s(settings: SupervisionSettings, rate_hz: float | None, *, started: bool) -> float:
    """How long a source may be silent: from start to first frame, or from frame to frame.

    `rate_hz` is None where the source does not tell it.
    """
    limit_s = SHARE * max(settings.stall_s, settings.stall_frames / rate_hz if rate_hz else 0.0)
    return limit_s if started else max(limit_s, settings.first_frame_s)


def is_stalled(now_ns: int, last_frame_ns: int, limit_s: float) -> bool:
    """Whether no frame came for `limit_s`."""
    return now_ns - last_frame_ns >= limit_s * 1e9


def is_hung(now_ns: int, call: Call | None, hung_s: float) -> bool:
    """Whether a call of the driver should have returned `hung_s` ago."""
    return call is not None and now_ns - call.since_ns > (call.allowed_s + hung_s) * 1e9
