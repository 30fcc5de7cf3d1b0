"""What operators are told of the picture before them, from the evidence of frames, never from hope: pure functions."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from service.acquisition.content import Content, frozen, no_picture
from service.acquisition.health import AcquisitionState
from service.acquisition.watchdog import is_stalled, silence_limit_s

if TYPE_CHECKING:
    from service.config.supervision import SupervisionSettings

__all__ = ["Evidence", "Liveness", "Shown", "shown"]

MEASURING_S: Final = 2.0
"""A frame that is measured for longer holds all others up."""


class Liveness(enum.StrEnum):
    """What the picture before the operator is worth.

    LIVE: frames come, and are a camera's; REPLAY: a recording's; SIMULATED: nobody's. NO SIGNAL: frames come, or none,
    and there is nothing in them. FROZEN: they are all the same. STALE: none comes, or they come too late, or are not
    measured. RECONNECTING: the device is gone or failed, and is looked for. STARTING: none came yet. ENDED: none will
    come any more.
    """

    STARTING = "STARTING"
    LIVE = "LIVE"
    REPLAY = "REPLAY"
    SIMULATED = "SIMULATED"
    NO_SIGNAL = "NO SIGNAL"
    FROZEN = "FROZEN"
    STALE = "STALE"
    RECONNECTING = "RECONNECTING"
    ENDED = "ENDED"


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of the frames at one moment.

    Attributes
    ----------
    kind
        What the frames are when nothing is wrong with them: LIVE, REPLAY or SIMULATED.
    state
        Where acquisition stands.
    trouble
        In words, what it recovers from; empty where it does not.
    since_ns
        When the last frame arrived, or before the first one when the stream was started; None before that.
    started
        Whether a frame arrived since the stream was started.
    rate_hz
        Frames a second that the device agreed to; None where it does not tell.
    late_ns
        Age of the last frame when it arrived; 0 where its times do not tell.
    content
        What the last frames showed; None where nobody looks, as with recordings.
    measuring_ns
        When the frame in hand was begun to be measured; None where none is.
    """

    kind: Liveness
    state: AcquisitionState
    trouble: str = ""
    since_ns: int | None = None
    started: bool = False
    rate_hz: float | None = None
    late_ns: int = 0
    content: Content | None = None
    measuring_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Shown:
    """The state shown, and in words why it is not LIVE. The words stay the same as long as the reason does."""

    liveness: Liveness
    reason: str = ""
    since_ns: int | None = None
    """Since when the picture is not new any more, where that is known."""

    @property
    def good(self) -> bool:
        """Whether the picture is what it claims to be, now."""
        return self.liveness in GOOD

    def __str__(self) -> str:
        return f"{self.liveness}: {self.reason}" if self.reason else str(self.liveness)


GOOD: Final = {Liveness.LIVE, Liveness.REPLAY, Liveness.SIMULATED}
OVER: Final = {
    AcquisitionState.CLOSED: "stopped",
    AcquisitionState.ENDED: "the recording is over",
    AcquisitionState.LOST: "the source is gone",
    AcquisitionState.FAULTED: "the source failed",
}


def shown(now_ns: int, evidence: Evidence, settings: SupervisionSettings) -> Shown:
    """What to show now; what explains the others comes first."""
    e = evidence
    if e.trouble:
        return Shown(Liveness.RECONNECTING, e.trouble, e.since_ns)
    if e.state in OVER:
        return Shown(Liveness.ENDED, OVER[e.state], e.since_ns)
    if e.since_ns is None:
        return Shown(Liveness.STARTING)
    if is_stalled(now_ns, e.since_ns, silence_limit_s(settings, e.rate_hz, started=e.started)):
        return _silent(e)
    if not e.started:
        return Shown(Liveness.STARTING, "no frame yet")
    return _seen(now_ns, e, settings)


def _silent(e: Evidence) -> Shown:
    """No frame comes; a device that says why is believed."""
    nothing = None if e.content is None else no_picture(e.content, frames=2**31)
    if nothing is not None:
        return Shown(Liveness.NO_SIGNAL, nothing, e.since_ns)
    return Shown(Liveness.STALE, "no frame comes" if e.started else "no frame came since it was started", e.since_ns)


def _seen(now_ns: int, e: Evidence, settings: SupervisionSettings) -> Shown:
    """Frames come: are they a camera's, new, and measured."""
    if e.content is not None and (nothing := no_picture(e.content, settings.frozen_frames)) is not None:
        return Shown(Liveness.NO_SIGNAL, nothing)
    if e.content is not None and (same := frozen(e.content, settings.frozen_frames)) is not None:
        return Shown(Liveness.FROZEN, same, e.content.same_since_ns)
    if e.late_ns > settings.late_s * 1e9:
        return Shown(Liveness.STALE, "frames arrive too late", e.since_ns)
    if e.measuring_ns is not None and now_ns - e.measuring_ns > MEASURING_S * 1e9:
        return Shown(Liveness.STALE, "measuring stands still", e.measuring_ns)
    return Shown(e.kind)
