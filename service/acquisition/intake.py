"""Where every frame of the source comes in: numbered through, looked at, counted, handed on."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from service.acquisition.health import Rate, Window
from service.acquisition.ledger import Outcome
from service.acquisition.repeated import RepeatedLog

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.frame import Frame
    from drivers.grabber import Clock
    from service.acquisition.content import PictureWatch
    from service.acquisition.ledger import Ledger
    from service.acquisition.slot import FrameQueue, HandOver

__all__ = ["Arrival", "Intake"]

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Arrival:
    """The last thing that came of the source: a frame, or the start of its stream before there is one."""

    time_ns: int
    started: bool = False
    late_ns: int = 0
    bad: bool = False


class Intake:
    """Takes frames from whoever owns the source now. `take` is called by one thread at a time.

    Parameters
    ----------
    hand_over
        Where frames go to be measured.
    ledger
        Counts them.
    subscribers
        Lossless queues that get every frame there is room for.
    watch
        Looks at what frames of a live source show; None for recordings, whose times are not the clock's either.
    """

    def __init__(
        self,
        hand_over: HandOver,
        ledger: Ledger,
        subscribers: Sequence[FrameQueue],
        clock: Clock,
        watch: PictureWatch | None,
    ) -> None:
        self._hand_over, self._ledger, self._subscribers, self._clock = hand_over, ledger, subscribers, clock
        self._log = RepeatedLog(log, clock)
        self._shift = 0
        self._counting: int | None = None
        self._last_ns: int | None = None
        self.watch = watch
        self.rate, self.interval_ms = Rate(), Window()
        self.last: Arrival | None = None
        self.generation = 0
        """Of the last stream: grows whenever one begins, whatever device it came from."""

    def begin_stream(self, generation: int) -> None:
        """Take note that a stream begins, of a grabber with that generation of its own."""
        self._shift = max(self.generation + 1, generation) - generation
        self.generation = generation + self._shift
        self.last = Arrival(self._clock.monotonic_ns())
        if self.watch is not None:
            self.watch.restart()

    def begin_view(self) -> None:
        """Take note that the same stream shows something else from now on, such as another input."""
        self._shift += 1
        self.generation += 1
        if self._counting is not None:
            self._counting = self.generation  # its numbers go on
        if self.watch is not None:
            self.watch.restart()

    def take(self, frame: Frame) -> None:
        """Count a frame, mark it where it shows nothing, and hand it on. Waits where the hand-over does."""
        if self._shift:
            frame = replace(frame, generation=frame.generation + self._shift)
        if self.watch is not None:
            frame = self.watch.look(frame)
        if frame.generation != self._counting:
            self._counting = self.generation = frame.generation
            self._ledger.begin_stream()
        self._ledger.arrived(frame)
        self._note(frame)
        self._pass_on(frame)

    def _note(self, frame: Frame) -> None:
        now_ns = self._clock.monotonic_ns()
        if self.last is not None and self.last.started:
            self.interval_ms.add((now_ns - self.last.time_ns) / 1e6)
        late_ns = 0 if self.watch is None else frame.received_ns - frame.timestamp_ns
        self._last_ns = now_ns
        self.last = Arrival(now_ns, started=True, late_ns=late_ns, bad=frame.defect is not None)
        self.rate.add(now_ns)
        if frame.defect is not None:
            self._log.warning("defect", f"{frame.source}: frame {frame.sequence} is bad: {frame.defect}")

    def _pass_on(self, frame: Frame) -> None:
        for queue in self._subscribers:
            if not queue.offer(frame):
                self._log.warning(
                    "overflow", f"{frame.source}: a lossless queue is full; frame {frame.sequence} left out"
                )
        displaced = self._hand_over.put(frame)
        if displaced is not None and displaced is not frame:  # itself: closed, left in flight
            self._ledger.settle(displaced, Outcome.SUPERSEDED)

    def silent_s(self, now_ns: int) -> float | None:
        """Time since the last frame; None before the first."""
        return None if self._last_ns is None else (now_ns - self._last_ns) / 1e9

    def close(self) -> None:
        """Say that no frame will come any more."""
        for queue in (self._hand_over, *self._subscribers):
            queue.close()
