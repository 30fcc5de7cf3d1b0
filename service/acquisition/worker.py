"""The thread that measures: takes a frame, answers it, hands the answer to the sinks."""

from __future__ import annotations

import collections
import logging
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

from service.acquisition.health import Rate, Window
from service.acquisition.ledger import Outcome
from service.acquisition.repeated import RepeatedLog
from service.precedence import go_first

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.frame import Frame
    from drivers.grabber import Clock
    from service.acquisition.ledger import Ledger
    from service.acquisition.measuring import FrameMeasurer
    from service.acquisition.slot import HandOver
    from service.results import FrameResult
    from service.sinks.base import Sink

__all__ = ["Answer", "Worker"]

log = logging.getLogger(__name__)

TAKE_TIMEOUT_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """The last frame answered, for those who only want to look."""

    frame: Frame
    results: tuple[FrameResult, ...]
    latency_ms: float


class Worker:
    """Measures what the hand-over gives until that is exhausted or a stop is asked for.

    Parameters
    ----------
    hand_over
        Where frames come from.
    measurer
        Answers them.
    sinks
        Started; each gets every answer. One that raises is reported, counted and served again with the next.
    ledger
        Where each frame's fate is settled.
    clock
        The one that `Frame.received_ns` was read from.
    oldest_s
        A frame older than this is not measured; None: however old.
    """

    def __init__(
        self,
        hand_over: HandOver,
        measurer: FrameMeasurer,
        sinks: Sequence[Sink],
        ledger: Ledger,
        clock: Clock,
        oldest_s: float | None = None,
    ) -> None:
        self._hand_over, self._measurer, self._sinks, self._ledger = hand_over, measurer, sinks, ledger
        self._clock, self._oldest_s = clock, oldest_s
        self._log = RepeatedLog(log, clock)
        self._stop = threading.Event()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bowlsight-measuring", daemon=True)
        self.age_ms, self.latency_ms, self.rate = Window(), Window(), Rate()
        self.locks: collections.Counter[str] = collections.Counter()
        self.refused: collections.Counter[str] = collections.Counter()
        self.latest: Answer | None = None
        self.measuring_ns: int | None = None
        """When the frame in hand was begun to be measured; None where none is."""
        self.failure: Exception | None = None

    def start(self) -> None:
        """Begin to measure."""
        self._thread.start()

    def request_stop(self) -> None:
        """Ask it to end after the frame in hand; returns at once."""
        self._stop.set()

    def join(self, timeout_s: float) -> bool:
        """Wait for its end; False where it is still at a frame."""
        if self._thread.ident is None:
            return True
        # An interrupted Thread.join takes the thread for ended (CPython 3.11): wait for an event instead.
        return self._done.wait(max(0.0, timeout_s))

    def _run(self) -> None:
        go_first()
        try:
            while not self._stop.is_set():
                frame = self._hand_over.take(TAKE_TIMEOUT_S)
                if frame is not None:
                    self._process(frame)
                elif self._hand_over.exhausted:
                    return
        except Exception as error:
            log.exception("the measuring thread ends by a mistake of its own")
            self.failure = error
            self._hand_over.close()
        finally:
            self._done.set()

    def _process(self, frame: Frame) -> None:
        began_ns = self._clock.monotonic_ns()
        age_s = (began_ns - frame.received_ns) / 1e9
        if self._oldest_s is not None and age_s > self._oldest_s:
            self._ledger.settle(frame, Outcome.TOO_OLD)
            self._log.warning("old", f"{frame.source}: frame {frame.sequence} waited {age_s:.2f} s; not measured")
            return
        self.age_ms.add(age_s * 1e3)
        self.measuring_ns = began_ns
        results, outcome = self._measurer.answer(frame)
        self.measuring_ns = None
        self._ledger.settle(frame, outcome)
        now_ns = self._clock.monotonic_ns()
        latency_ms = (now_ns - frame.received_ns) / 1e6
        self.latency_ms.add(latency_ms)
        self.rate.add(now_ns)
        self.locks.update(str(r.measurement.lock) for r in results)
        self.latest = Answer(frame, results, latency_ms)
        for sink in self._sinks:
            self._deliver(sink, frame, results)

    def _deliver(self, sink: Sink, frame: Frame, results: tuple[FrameResult, ...]) -> None:
        try:
            sink.accept(frame, results)
        except Exception as error:  # noqa: BLE001 - whatever a sink does, measuring goes on
            self.refused[sink.name] += 1
            self._log.warning(sink.name, f"{sink.name}: refused frame {frame.sequence}: {error}", error)
