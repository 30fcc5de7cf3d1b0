"""What the worker hands its results to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.frame import Frame
    from service.results import FrameResult

__all__ = ["Sink", "SinkStats", "SourceState"]


@dataclass(frozen=True, slots=True)
class SinkStats:
    """What became of the frames a sink was handed, at one moment.

    Attributes
    ----------
    accepted
        Frames handed over, whatever became of them.
    dropped
        Of these, the frames given up because the sink could not keep up or was closed in time.
    failed
        Of these, the frames whose delivery raised an error.
    depth
        Frames waiting in the sink's queue.
    """

    accepted: int = 0
    dropped: int = 0
    failed: int = 0
    depth: int = 0


@dataclass(frozen=True, slots=True)
class SourceState:
    """What the picture before the operator is worth, for sinks that show it.

    Attributes
    ----------
    word
        LIVE, REPLAY, SIMULATED, STARTING, NO SIGNAL, FROZEN, STALE, RECONNECTING or ENDED.
    reason
        Why it is none of the first three; empty where it is.
    good
        Whether it is.
    figures
        How the service does, in lines of Markdown.
    """

    word: str
    reason: str = ""
    good: bool = False
    figures: str = ""


class Sink(Protocol):
    """A consumer of results. Whatever happens to it delays neither the worker nor capture.

    The worker calls `start`, then `accept` once a frame, then `close` once, all but `stats` from one thread at a time.
    """

    @property
    def name(self) -> str:
        """How the summary and the log call it."""
        ...

    def start(self) -> None:
        """Take what it needs, such as a file or port; raises a one-line error where that is not to be had."""
        ...

    def accept(self, frame: Frame, results: Sequence[FrameResult]) -> None:
        """Take one frame with its results: one, or two for interlaced video. Returns at once."""
        ...

    def close(self, timeout_s: float) -> None:
        """Deliver what can be delivered in that time, count the rest as dropped, and let go. May be repeated."""
        ...

    def stats(self) -> SinkStats:
        """What became of the frames so far. Callable from any thread."""
        ...
