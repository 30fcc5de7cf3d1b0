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

__all__ = ["QueuedSink", "SinkFailedError"]

log = logging.getLogger(__name__)

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
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"bowlsight-{name}", daemon=True)
        self._closing: tuple[float, float] | None = None  # once begun: until when to deliver, until when to end
        self._in_hand = self._abandoned = False
        self._accepted = self._dropped = self._failed = 0
        self._failure: str | None = None

    # -- hooks -------------------------------------------------------------------------------------------------------

    @abstractmethod
    def _do_start(self) -> None:
        """Take what delivering needs, in the caller's thread; where that raises, nothing stays taken."""

    @abstractmethod
    def _do_consume(self, frame: Frame, results: Sequence[FrameResult]) -> None:
        """Deliver one frame, in the sink's thread. May block. May raise."""

    @abstractmethod
    def _do_finish(self, timeout_s: float) -> None:
        """Flush and let go, in the sink's thread, within about `timeout_s`."""

    def _do_abandon(self) -> None:  # noqa: B027 - most sinks have nothing to do here
        """See to it that a thread that did not end in time holds nothing else up, in the thread of `close`."""

    # -- the sink ----------------------------------------------------------------------------------------------------

    @property
    def failure(self) -> str | None:
        """None, or in words why nothing is delivered any more."""
        return self._failure

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
        while (item := self._take()) is not None:
            self._deliver(*item)
        assert self._closing is not None, "ends only when closed"
        try:
            self._do_finish(max(0.0, self._closing[1] - time.monotonic()))
        except Exception as error:
            log.warning("%s: did not close cleanly: %s", self.name, error, exc_info=log.isEnabledFor(logging.DEBUG))

    def _take(self) -> tuple[Frame, Sequence[FrameResult]] | None:
        with self._changed:
            while not self._queue and self._closing is None:
                self._changed.wait()
            if self._closing is not None and time.monotonic() >= self._closing[0]:
                self._drop_waiting()
            if not self._queue:
                return None
            self._in_hand = True
            return self._queue.popleft()

    def _deliver(self, frame: Frame, results: Sequence[FrameResult]) -> None:
        error: Exception | None = None
        try:
            self._do_consume(frame, results)
        except Exception as raised:  # noqa: BLE001 - counted and told below; the next frame may go well
            error = raised
        with self._changed:
            if self._abandoned:  # counted as dropped already
                return
            self._in_hand = False
            if error is None:
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
        self._dropped += len(self._queue)
        self._queue.clear()

    def _abandon(self) -> None:
        with self._changed:
            self._abandoned = True
            self._drop_waiting()
            self._dropped += self._in_hand
            self._in_hand = False
        log.warning("%s: did not end in time and is left behind", self.name)
        self._do_abandon()
