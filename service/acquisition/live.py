"""The live service: one grabber, one measuring thread, any sinks, started and stopped as one."""

from __future__ import annotations

import logging
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import cv2

from service.acquisition.content import PictureWatch
from service.acquisition.health import Health
from service.acquisition.intake import Intake
from service.acquisition.ledger import Ledger
from service.acquisition.liveness import Liveness
from service.acquisition.measuring import FrameMeasurer
from service.acquisition.resources import resources
from service.acquisition.slot import FrameQueue, NewestSlot
from service.acquisition.supervisor import Supervisor
from service.acquisition.worker import Worker

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from types import TracebackType

    from drivers.frame import Field, Frame
    from drivers.grabber import FrameFormat, Grabber
    from service.acquisition.cross_check import CrossCheck
    from service.acquisition.liveness import Shown
    from service.acquisition.measuring import Measurer
    from service.acquisition.recovery import Supervision
    from service.acquisition.slot import HandOver
    from service.acquisition.worker import Answer
    from service.alignment.interpreter import Interpreter
    from service.sinks.base import Sink, SinkStats

__all__ = ["STOP_S", "LiveService"]

log = logging.getLogger(__name__)

OPEN_TIMEOUT_S = 30.0
STOP_S = 1.6
"""Time for a stop, of the two seconds promised: the rest is the interpreter's own way out."""
SINKS_SHARE_S = 0.4
"""Of it, what is kept for sinks to flush, however long the threads take."""
ORDERED_CAPACITY = 8


class LiveService:
    """Grabs, measures and hands on until stopped, or until the source ends or fails for good.

    Parameters
    ----------
    grabber
        Closed. The service's from `start` on.
    measurer_for
        Makes the measurer once the pictures' format is known; may raise ConfigError where they do not go together.
    sinks
        Not started.
    prepare
        Sets the grabber up once it is open, before it streams.
    every_frame
        Measure all frames in order and let the source wait, as a recording at full speed can; otherwise the newest.
    field
        What to take every frame for; None: as the source says.
    oldest_s
        Do not measure frames older than this; None: however old.
    interpreter
        Names the tubes and judges the alignment; None where neither is set up.
    check
        Holds results against lens and range finder; None where there is neither.
    kind
        What the source is when nothing is wrong with it: LIVE, REPLAY or SIMULATED.
    supervision
        How a live source is watched and got back; None for recordings, whose failures are final.
    memory_wanted
        Whether results are to be given what is remembered before their frame, for a recording that begins.
    remembered
        What to go on from, instead of from nothing; see `FrameMeasurer.recall`.
    tell
        Gets what happens to the source in words, with INFO, WARN or ERROR, from several threads. Must return at once.
    """

    def __init__(
        self,
        grabber: Grabber,
        measurer_for: Callable[[FrameFormat], Measurer],
        sinks: Sequence[Sink] = (),
        *,
        prepare: Callable[[Grabber], None] | None = None,
        every_frame: bool = False,
        field: Field | None = None,
        oldest_s: float | None = None,
        interpreter: Interpreter | None = None,
        check: CrossCheck | None = None,
        kind: Liveness = Liveness.LIVE,
        supervision: Supervision | None = None,
        tell: Callable[[str, str], None] | None = None,
        memory_wanted: Callable[[], bool] = lambda: False,
        remembered: Mapping[str, Any] | None = None,
    ) -> None:
        self._grabber, self._measurer_for, self._sinks = grabber, measurer_for, tuple(sinks)
        self._interpreter, self._check = interpreter, check
        self._memory_wanted, self._remembered = memory_wanted, remembered
        self._clock, self._field, self._oldest_s = grabber.clock, field, oldest_s
        self._ledger = Ledger()
        self._hand_over: HandOver = FrameQueue(ORDERED_CAPACITY) if every_frame else NewestSlot()
        self._subscribers: list[FrameQueue] = []
        watch = None
        if supervision is not None:
            watch = PictureWatch(supervision.settings.frozen_frames, supervision.settings.flat_levels)
        self._intake = Intake(self._hand_over, self._ledger, self._subscribers, self._clock, watch)
        self._acquisition = Supervisor(
            grabber,
            self._intake,
            kind,
            prepare,
            supervision,
            tell,
            lambda: None if self._worker is None else self._worker.measuring_ns,
        )
        self._worker: Worker | None = None
        self._started_sinks: list[Sink] = []
        self._switch_interval_s = sys.getswitchinterval()
        self.stuck: list[str] = []
        """What did not stop in time, for the summary."""

    def subscribe(self, capacity: int, *, waits: bool = False) -> FrameQueue:
        """Ask, before `start`, for every frame in a bounded queue; with `waits`, the source waits for room."""
        queue = FrameQueue(capacity, waits=waits)
        self._subscribers.append(queue)
        return queue

    def open(self) -> FrameFormat:
        """Take all that is needed: source, camera, sinks. What cannot be had is raised, and nothing is left running.

        Raises
        ------
        DeviceError
            The source cannot be opened.
        ConfigError
            Its pictures do not go with the camera, or a sink lacks what it needs.
        """
        sys.setswitchinterval(0.0005)  # the capture thread wakes in 0.6 ms beside a busy worker, instead of 5
        cv2.setNumThreads(1)  # a second thread costs capture its core and gains nothing
        try:
            picture_format = self._acquisition.open(OPEN_TIMEOUT_S)
            vision = self._measurer_for(picture_format)

            def remake(frame: Frame) -> Measurer:
                width_px, height_px = frame.size_px
                return self._measurer_for(replace(picture_format, width_px=width_px, height_px=height_px))

            measurer = FrameMeasurer(
                vision, self._field, self._clock, self._interpreter, self._check, remake, self._memory_wanted
            )
            if self._remembered is not None:
                measurer.recall(self._remembered)
            for sink in self._sinks:
                self._started_sinks.append(sink)
                sink.start()
        except BaseException:
            self.stop()
            raise
        self._worker = Worker(self._hand_over, measurer, self._sinks, self._ledger, self._clock, self._oldest_s)
        return picture_format

    def begin(self) -> None:
        """Begin to grab and to measure, once open."""
        assert self._worker is not None, "opened"
        self._worker.start()
        self._acquisition.begin()

    def start(self) -> FrameFormat:
        """Open and begin."""
        picture_format = self.open()
        self.begin()
        return picture_format

    def wait(self, timeout_s: float) -> bool:
        """Wait until the source is over and everything taken from it answered; False where it is not yet."""
        deadline = time.monotonic() + timeout_s
        if self._worker is None:
            return True
        if not self._worker.join(timeout_s):
            return False
        self._acquisition.request_stop()  # where the worker ended by a mistake of its own, nobody measures any more
        return self._acquisition.join(deadline - time.monotonic())

    def select_input(self, name: str) -> None:
        """Have the source switched to another of its inputs; raises ValueError where it has none of that name."""
        self._acquisition.select_input(name)

    def stop(self, timeout_s: float = STOP_S) -> None:
        """Stop from any state: end capture, measure what waits if there is time, flush the sinks. May be repeated."""
        deadline, threads_s = time.monotonic() + timeout_s, timeout_s - SINKS_SHARE_S
        self._acquisition.request_stop()
        self._acquisition.join(threads_s / 3)
        for queue in (self._hand_over, *self._subscribers):
            queue.close()
        if self._worker is not None and not self._worker.join(threads_s / 3):
            self._worker.request_stop()
        for part, name in ((self._acquisition, "the acquisition thread"), (self._worker, "the measuring thread")):
            if part is not None and not part.join(deadline - SINKS_SHARE_S - time.monotonic()):
                self._note_stuck(name)
        while self._started_sinks:
            share = max(0.1, deadline - time.monotonic()) / len(self._started_sinks)
            self._close(self._started_sinks.pop(), share)
        sys.setswitchinterval(self._switch_interval_s)

    def _close(self, sink: Sink, timeout_s: float) -> None:
        try:
            sink.close(timeout_s)
        except Exception:
            log.exception("%s: closing failed", sink.name)

    def _note_stuck(self, name: str) -> None:
        if name not in self.stuck:
            self.stuck.append(name)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    # -- looking at it ------------------------------------------------------------------------------------------------

    @property
    def failure(self) -> Exception | None:
        """What ended the service, where that was neither a stop nor the end of a recording."""
        return self._acquisition.failure or (self._worker.failure if self._worker else None)

    @property
    def latest(self) -> Answer | None:
        """The last frame answered."""
        return self._worker.latest if self._worker else None

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the source's inputs, once open."""
        return self._acquisition.inputs

    @property
    def input(self) -> str:
        """Name of the input in use, once open."""
        return self._acquisition.input

    @property
    def shown(self) -> Shown:
        """What the picture is worth now."""
        return self._acquisition.shown()

    def health(self) -> Health:
        """How it is doing now."""
        now_ns, acquisition, worker = self._clock.monotonic_ns(), self._acquisition, self._worker
        assert worker is not None, "not started"
        return Health(
            shown=acquisition.shown(),
            state=acquisition.state,
            generation=self._intake.generation,
            recoveries=acquisition.recoveries,
            capture_fps=self._intake.rate.per_second(now_ns),
            result_fps=worker.rate.per_second(now_ns),
            silent_s=self._intake.silent_s(now_ns),
            interval_ms=self._intake.interval_ms.percentiles(),
            age_ms=worker.age_ms.percentiles(),
            latency_ms=worker.latency_ms.percentiles(),
            measuring_s=None if worker.measuring_ns is None else (now_ns - worker.measuring_ns) / 1e9,
            waiting=self._hand_over.depth,
            overflowed=sum(queue.overflowed for queue in self._subscribers),
            account=self._ledger.account(),
            locks=dict(worker.locks),
            sinks={sink.name: self._stats(sink, worker.refused[sink.name]) for sink in self._sinks},
            resources=resources(),
        )

    @staticmethod
    def _stats(sink: Sink, refused: int) -> SinkStats:
        stats = sink.stats()
        return replace(stats, accepted=stats.accepted + refused, failed=stats.failed + refused)
