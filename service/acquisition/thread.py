"""The thread that owns the grabber: opens it, reads it, hands every frame on, never waits for anyone downstream."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING

from drivers.errors import DeviceDisconnectedError, DeviceError, DeviceTimeoutError, EndOfRecordingError
from service.acquisition.health import AcquisitionState, Rate
from service.acquisition.ledger import Outcome
from service.acquisition.repeated import RepeatedLog

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from drivers.frame import Frame
    from drivers.grabber import Clock, FrameFormat, Grabber
    from service.acquisition.ledger import Ledger
    from service.acquisition.slot import FrameQueue, HandOver

__all__ = ["AcquisitionThread", "is_stalled"]

log = logging.getLogger(__name__)

READ_TIMEOUT_S = 0.1
STALL_FRAMES, STALL_S = 5, 0.5


def is_stalled(now_ns: int, last_frame_ns: int, rate_hz: float | None) -> bool:
    """Whether the source has been silent for more than five frames and half a second."""
    limit_s = max(STALL_S, STALL_FRAMES / rate_hz if rate_hz else 0.0)
    return now_ns - last_frame_ns > limit_s * 1e9


class AcquisitionThread:
    """Reads a grabber from `open` until stopped, or until it ends or fails.

    Parameters
    ----------
    grabber
        Closed; from `open` on only this thread touches it.
    hand_over
        Where frames go to be measured.
    ledger
        Counts them.
    subscribers
        Lossless queues that get every frame there is room for.
    prepare
        Called once the grabber is open, before it streams: sets input, standard and controls.
    """

    def __init__(
        self,
        grabber: Grabber,
        hand_over: HandOver,
        ledger: Ledger,
        subscribers: Sequence[FrameQueue] = (),
        prepare: Callable[[Grabber], None] | None = None,
    ) -> None:
        self._grabber, self._hand_over, self._ledger, self._subscribers = grabber, hand_over, ledger, subscribers
        self._prepare = prepare
        self._clock: Clock = grabber.clock
        self._log = RepeatedLog(log, self._clock)
        self._stop = threading.Event()
        self._opened = threading.Event()
        self._begin = threading.Event()
        self._done = threading.Event()
        self._format: FrameFormat | None = None
        self._last_frame_ns = 0
        self._thread = threading.Thread(target=self._run, name="bowlsight-acquisition", daemon=True)
        self.rate = Rate()
        self.state = AcquisitionState.CLOSED
        self.failure: Exception | None = None
        """What ended it, where that was neither a stop nor the end of a recording."""

    # -- called from outside -------------------------------------------------------------------------------------------

    def open(self, timeout_s: float) -> FrameFormat:
        """Start the thread and let it open the grabber; raises what that raised, or DeviceTimeoutError."""
        self.state = AcquisitionState.OPENING
        self._thread.start()
        if not self._opened.wait(timeout_s):
            self.request_stop()
            raise DeviceTimeoutError(self._grabber.name, f"did not open within {timeout_s:g} s; is the device hung?")
        if self.failure is not None:
            raise self.failure
        assert self._format is not None
        return self._format

    def begin(self) -> None:
        """Let it stream."""
        self._begin.set()

    def request_stop(self) -> None:
        """Ask it to end; returns at once."""
        self._stop.set()
        self._begin.set()

    def join(self, timeout_s: float) -> bool:
        """Wait for its end; False where it is stuck in its device."""
        if self._thread.ident is None:
            return True
        # An interrupted Thread.join takes the thread for ended (CPython 3.11): wait for an event instead.
        return self._done.wait(max(0.0, timeout_s))

    @property
    def generation(self) -> int:
        """How often the grabber was opened."""
        return self._grabber.generation

    def silent_s(self, now_ns: int) -> float | None:
        """Time since the last frame; None before the first."""
        return (now_ns - self._last_frame_ns) / 1e9 if self._ledger.account().delivered else None

    # -- the thread itself ---------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._acquire()
            self.state = AcquisitionState.CLOSED
        except EndOfRecordingError:
            self.state = AcquisitionState.ENDED
        except DeviceDisconnectedError as error:
            self._fail(AcquisitionState.LOST, error)
        except DeviceError as error:
            self._fail(AcquisitionState.FAULTED, error)
        except Exception as error:  # whatever a driver does, the service ends in order
            log.exception("%s: the driver failed in a way it does not announce", self._grabber.name)
            self._fail(AcquisitionState.FAULTED, error)
        finally:
            self._let_go()

    def _fail(self, state: AcquisitionState, error: Exception) -> None:
        self.failure, self.state = error, state

    def _acquire(self) -> None:
        self._grabber.open()
        if self._prepare is not None:
            self._prepare(self._grabber)
        self._format = self._grabber.format
        self._opened.set()
        while not self._begin.wait(1.0):
            pass
        if self._stop.is_set():
            return
        self._ledger.begin_stream()
        self._grabber.start()
        self._last_frame_ns = self._clock.monotonic_ns()
        while not self._stop.is_set():
            self._read_once()

    def _read_once(self) -> None:
        try:
            frame = self._grabber.read(READ_TIMEOUT_S)
        except TimeoutError:
            self._watch()
            return
        self._ledger.arrived(frame)
        self._last_frame_ns = self._clock.monotonic_ns()
        self.rate.add(self._last_frame_ns)
        if frame.defect is None:
            self.state = AcquisitionState.RUNNING
        else:
            self._log.warning("defect", f"{frame.source}: frame {frame.sequence} is bad: {frame.defect}")
            self.state = AcquisitionState.DEGRADED
        self._pass_on(frame)

    def _pass_on(self, frame: Frame) -> None:
        for queue in self._subscribers:
            if not queue.offer(frame):
                self._log.warning(
                    "overflow", f"{frame.source}: a lossless queue is full; frame {frame.sequence} left out"
                )
        displaced = self._hand_over.put(frame)
        if displaced is not None and displaced is not frame:  # itself: closed, left in flight
            self._ledger.settle(displaced, Outcome.SUPERSEDED)

    def _watch(self) -> None:
        assert self._format is not None
        if is_stalled(self._clock.monotonic_ns(), self._last_frame_ns, self._format.rate_hz):
            self._log.warning("stalled", f"{self._grabber.name}: no frame comes any more")
            self.state = AcquisitionState.STALLED

    def _let_go(self) -> None:
        try:
            self._grabber.close()
        except Exception:
            log.exception("%s: closing failed", self._grabber.name)
        for queue in (self._hand_over, *self._subscribers):
            queue.close()
        self._opened.set()
        self._done.set()
