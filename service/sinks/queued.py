"""A sink with a thread of its own behind a bounded queue, so that whatever befalls it stays with it."""

from __future__ import annotations

import collections
import logging
import threading
import time
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from service.sinks.base import SinkStats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.sinks.base import SourceState

__all__ = ["QueuedSink", "SinkFailedError"]

log = logging.getLogger(__name__)

EVENTS_CAPACITY = 100
DRAIN_SHARE = 0.7
"""Of the time to close: for delivering what waits. The rest is for the sink's own end."""


class SinkFailedError(Exception):
    """Raised by `_do_consume` where nothing more can be delivered, in words; any other error costs its frame only."""


class QueuedSink(ABC):
    """Takes frames into a queue that forgets the oldest, and delivers them from its own thread.

    Subclasses fill in the `_do_` hooks. Frames handed over = delivered + dropped + failed + waiting, always.

    Parameters
    ----------
    name
        How the summary, the log and the thread are called.
    capacity
        Frames that may wait; one more and the oldest is dropped and counted.
    """

    def __init__(self, name: str, capacity: int) -> None:
        self.name = name
        self._capacity = capacity
        self._queue: collections.deque[tuple[Frame, Sequence[FrameResult]]] = collections.deque()
        self._events: collections.deque[tuple[str, str]] = collections.deque()
        self._state: SourceState | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"bowlsight-{name}", daemon=True)
        self._closing: tuple[float, float] | None = None  # once begun: until when to deliver, until when to end
        self._in_hand = self._abandoned = False
        self._accepted = self._dropped = self._failed = 0
        self._failure: str | None = None
        self.events_dropped = 0
        """Events given up because too many waited."""

    # -- hooks -------------------------------------------------------------------------------------------------------

    @abstractmethod
    def _do_start(self) -> None:
        """Take what delivering needs, in the caller's thread; where that raises, nothing stays taken."""

    @abstractmethod
    def _do_consume(self, frame: Frame, results: Sequence[FrameResult]) -> bool:
        """Deliver one frame, in the sink's thread; False where it was let go instead. May block. May raise."""

    @abstractmethod
    def _do_finish(self, timeout_s: float) -> None:
        """Flush and let go, in the sink's thread, within about `timeout_s`."""

    def _do_event(self, text: str, level: str) -> None:  # noqa: B027 - nor here
        """Show or keep an event, in the sink's thread; sinks that show none ignore it. May raise."""

    def _do_state(self, state: SourceState) -> None:  # noqa: B027 - nor here
        """Show what the picture is worth, in the sink's thread; sinks that show nothing ignore it. May raise."""

    def _do_abandon(self) -> None:  # noqa: B027 - most sinks have nothing to do here
        """See to it that a thread that did not end in time holds nothing else up, in the thread of `close`."""

    # -- the sink ----------------------------------------------------------------------------------------------------

    @property
    def failure(self) -> str | None:
        """None, or in words why nothing is delivered any more."""
        return self._failure

    @property
    def running(self) -> bool:
        """Whether its thread may still deliver something: after `close`, where it was left behind."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Take what is needed and start the thread; raises what `_do_start` raises."""
        self._do_start()
        self._thread.start()

    def accept(self, frame: Frame, results: Sequence[FrameResult]) -> None:
        """Put one frame into the queue. Returns at once, and never raises."""
        with self._changed:
            self._accepted += 1
            if self._failure is not None:
                self._failed += 1
                return
            if self._closing is not None:
                self._dropped += 1
                return
            self._queue.append((frame, results))
            if len(self._queue) > self._capacity:
                self._queue.popleft()
                self._dropped += 1
            self._changed.notify()

    def event(self, text: str, level: str = "INFO") -> None:
        """Pass on a line of text (INFO, WARN or ERROR) before the frames that wait. Returns at once, never raises."""
        with self._changed:
            self._events.append((text, level))
            if len(self._events) > EVENTS_CAPACITY:
                self._events.popleft()
                self.events_dropped += 1
            self._changed.notify()

    def state(self, state: SourceState) -> None:
        """Pass on what the picture is worth; only the newest is shown. Returns at once, never raises."""
        with self._changed:
            self._state = state
            self._changed.notify()

    def close(self, timeout_s: float) -> None:
        """Deliver what can be delivered in time, count the rest as dropped, end the thread. May be repeated."""
        with self._changed:
            if self._closing is None:
                now = time.monotonic()
                self._closing = now + DRAIN_SHARE * timeout_s, now + timeout_s
            self._changed.notify()
        if self._thread.ident is None:
            return
        self._thread.join(timeout_s)
        if self._thread.is_alive() and not self._abandoned:
            self._abandon()

    def stats(self) -> SinkStats:
        """What became of the frames so far; one being delivered counts as waiting."""
        with self._changed:
            return SinkStats(self._accepted, self._dropped, self._failed, len(self._queue) + self._in_hand)

    # -- the thread --------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while self._wait():
            self._deliver_state()
            self._deliver_events()
            if (item := self._take()) is not None:
                self._deliver(*item)
        assert self._closing is not None, "ends only when closed"
        try:
            self._do_finish(max(0.0, self._closing[1] - time.monotonic()))
        except Exception as error:
            log.warning("%s: did not close cleanly: %s", self.name, error, exc_info=log.isEnabledFor(logging.DEBUG))

    def _wait(self) -> bool:
        """Wait for something to deliver; False where nothing will come any more."""
        with self._changed:
            while not (self._queue or self._events or self._state or self._closing):
                self._changed.wait()
            if self._closing is not None and time.monotonic() >= self._closing[0]:
                self._drop_waiting()
            return bool(self._queue or self._events or self._state)

    def _deliver_state(self) -> None:
        with self._changed:
            state, self._state = self._state, None
        if state is None:
            return
        try:
            self._do_state(state)
        except Exception as error:  # noqa: BLE001 - told; the next one may go well
            log.warning("%s: state %s not delivered: %s", self.name, state.word, error)

    def _deliver_events(self) -> None:
        while True:
            with self._changed:
                if not self._events:
                    return
                text, level = self._events.popleft()
            try:
                self._do_event(text, level)
            except Exception as error:  # noqa: BLE001 - told; what follows may go well
                log.warning("%s: event %r not delivered: %s", self.name, text, error)

    def _take(self) -> tuple[Frame, Sequence[FrameResult]] | None:
        with self._changed:
            if not self._queue:
                return None
            self._in_hand = True
            return self._queue.popleft()

    def _deliver(self, frame: Frame, results: Sequence[FrameResult]) -> None:
        delivered, error = False, None
        try:
            delivered = self._do_consume(frame, results)
        except Exception as raised:  # noqa: BLE001 - counted and told below; the next frame may go well
            error = raised
        with self._changed:
            if self._abandoned:  # counted as dropped already
                return
            self._in_hand = False
            if error is None:
                self._dropped += not delivered
                return
            self._failed += 1
            if isinstance(error, SinkFailedError):
                self._failure = str(error)
                self._failed += len(self._queue)
                self._queue.clear()
            failed = self._failed
        self._tell(frame, error, failed)

    def _tell(self, frame: Frame, error: Exception, failed: int) -> None:
        if self._failure is not None:
            log.error("%s: %s; the rest of the service goes on without it", self.name, self._failure)
        elif failed & (failed - 1) == 0:  # the 1st, 2nd, 4th, 8th ...: a fault on every frame does not flood the log
            log.warning(
                "%s: frame %s not delivered: %s: %s (%d so far)", self.name, frame.sequence, type(error).__name__,
                error, failed, exc_info=log.isEnabledFor(logging.DEBUG),
            )  # fmt: skip

    def _drop_waiting(self) -> None:
        self._state = None
        self._dropped += len(self._queue)
        self._queue.clear()
        self.events_dropped += len(self._events)
        self._events.clear()

    def _abandon(self) -> None:
        with self._changed:
            self._abandoned = True
            self._drop_waiting()
            self._dropped += self._in_hand
            self._in_hand = False
        log.warning("%s: did not end in time and is left behind", self.name)
        self._do_abandon()
