"""The recorder: takes every frame and every result, and writes sessions, in one thread of its own."""

from __future__ import annotations

import collections
import logging
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias, TypeVar

import av

from drivers.errors import ConfigError
from service.sinks.base import SinkStats
from service.sinks.session.asking import Asked
from service.sinks.session.control import RecordingError, RecordingState
from service.sinks.session.places import VIEWER, is_full
from service.sinks.session.running import FrameKey, RunningSession, frame_key
from service.sinks.session.surroundings import device
from service.sinks.session.upkeep import Upkeep, free_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from drivers.frame import Frame
    from drivers.grabber import Clock, Grabber
    from service.results import FrameResult
    from service.sinks.evidence import EvidenceRecord
    from service.sinks.queued import QueuedSink
    from service.sinks.session.plan import RecordingPlan

__all__ = ["FRAMES_CAPACITY", "FrameSource", "SessionRecorder"]

log = logging.getLogger(__name__)

FRAMES_CAPACITY: Final = 90
"""Frames that may wait: three seconds of television for a slow disk, 80 MB of it at 1280x720."""
ANSWERS_CAPACITY, EVENTS_CAPACITY = 2000, 1000
WAIT_S = 0.05
FOLLOW_EVERY_S = 1.0
VIEWER_CLOSE_S = 1.0
DRAIN_SHARE = 0.7
"""Of the time to close: for writing what waits. The rest is for the files' own ends."""
T = TypeVar("T")
Seen: TypeAlias = "tuple[Frame, Sequence[FrameResult]]"


class FrameSource(Protocol):
    """Every frame, in order, with a bound; as `LiveService.subscribe` gives it."""

    overflowed: int

    def take(self, timeout_s: float) -> Frame | None:
        """Wait for the oldest frame; None where none came in time."""
        ...

    @property
    def depth(self) -> int:
        """Frames waiting."""
        ...

    @property
    def exhausted(self) -> bool:
        """Whether no more will come."""
        ...


class SessionRecorder:
    """Records sessions: a sink of results, a subscriber to all frames, and `SessionControl`.

    Whatever befalls it, such as a full disk, ends the recording and nothing else.

    Parameters
    ----------
    plan
        What to record, and where.
    clock
        The one that `Frame.received_ns` was read from.
    remembers
        Whether results bring what was remembered before their frame, when `memory_wanted`: a session that begins in the
        midst of a watch then begins with that.
    viewer_for
        Makes the sink that records what the viewer shows, into a file; None: that is not recorded.
    wall_ns
        UTC.
    free
        What is free where a folder is, bytes.
    """

    name = "recorder"

    def __init__(
        self,
        plan: RecordingPlan,
        clock: Clock,
        *,
        remembers: bool = False,
        viewer_for: Callable[[Path], QueuedSink] | None = None,
        wall_ns: Callable[[], int] = time.time_ns,
        free: Callable[[Path], int] = free_bytes,
    ) -> None:
        self._plan, self._clock, self._viewer_for, self._wall_ns = plan, clock, viewer_for, wall_ns
        self._remembers = remembers
        self._frames: FrameSource | None = None
        self._device: dict[str, Any] = {}
        self._answers: collections.deque[tuple[FrameKey | None, Sequence[FrameResult]]] = collections.deque()
        self._events: collections.deque[tuple[str, str, str, dict[str, Any]]] = collections.deque(
            maxlen=EVENTS_CAPACITY
        )
        self._asked = Asked()
        self._newest: Seen | None = None
        self._running: RunningSession | None = None
        self._viewer: QueuedSink | None = None
        self._state = RecordingState()
        self._failure: str | None = None
        self._accepted = self._lost = self._overflow_told = 0
        self._gap, self._follow_s = False, 0.0
        self._upkeep = Upkeep(
            plan.root, plan.settings, lambda t: self.event(t, kind="retention"), lambda: wall_ns() / 1e9, free
        )
        self._closing = threading.Event()
        self._deadline_s = self._end_s = float("inf")
        self._thread = threading.Thread(target=self._run, name="bowlsight-recorder", daemon=True)

    # -- around it ----------------------------------------------------------------------------------------------------

    def listen(self, frames: FrameSource) -> None:
        """Take frames from there; call it before `start`."""
        self._frames = frames

    def note_device(self, grabber: Grabber) -> None:
        """Take note of how an open grabber is set; call it where the grabber may be asked, each time it was opened."""
        again, self._device = bool(self._device), device(grabber)
        if again:
            self.event(f"{grabber.name} was opened again", kind="device", device=self._device)

    @property
    def memory_wanted(self) -> bool:
        """Whether the next results are to bring what was remembered before their frame. Callable from any thread."""
        running = self._running
        return running is not None and running.awaits_memory

    # -- the sink ------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin a session, if that is wanted from the start, and the thread; raises ConfigError."""
        assert self._frames is not None, "listens"
        if self._plan.settings.enabled:
            try:
                self._begin(from_start=True)
            except OSError as error:
                self._fail(error)
        self._thread.start()

    def accept(self, frame: Frame, results: Sequence[FrameResult]) -> None:
        """Take a frame's results. Returns at once, and never raises."""
        self._accepted += 1
        self._newest = frame, results
        if len(self._answers) >= ANSWERS_CAPACITY:
            self._lost, self._gap = self._lost + 1, True
        else:
            if self._gap:
                self._answers.append((None, ()))
            self._answers.append((frame_key(frame), results))
            self._gap = False
        if (viewer := self._viewer) is not None:
            viewer.accept(frame, results)

    def event(self, text: str, level: str = "INFO", *, kind: str = "service", **more: Any) -> None:
        """Take note of what happened: INFO, WARN or ERROR. Returns at once, and never raises."""
        self._events.append((kind, text, level, more))
        if (viewer := self._viewer) is not None:
            viewer.event(text, level)

    def close(self, timeout_s: float) -> None:
        """Write what waits, end the session, end the thread. May be repeated."""
        if not self._closing.is_set():
            now_s = time.monotonic()
            self._deadline_s, self._end_s = now_s + DRAIN_SHARE * timeout_s, now_s + timeout_s
            self._closing.set()
        if self._thread.ident is None:
            self._finish("stopped before it began")
            return
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            log.warning("recorder: did not end in time and is left behind; the session is as after a power failure")

    def stats(self) -> SinkStats:
        """What became of the answers so far."""
        return SinkStats(self._accepted, self._lost, 0, len(self._answers))

    # -- SessionControl: from any thread -------------------------------------------------------------------------------

    @property
    def state(self) -> RecordingState:
        """How recording does."""
        return self._state

    def start_recording(self) -> Path:
        """Begin a new session; gives its folder. Raises RecordingError."""
        return self._ask(self._begin_asked)

    def stop_recording(self) -> Path | None:
        """End the session, if there is one; gives its folder."""
        return self._ask(lambda: self._finish("stopped by the operator"))

    def mark(self, text: str, operator: str = "") -> EvidenceRecord:
        """Note a mark, and put the frames before and after it on record; gives the record of the frame before."""
        frame, results = self._seen()
        by = operator or self._plan.settings.operator
        return self._ask(lambda: self._session().mark(frame, results[-1], " ".join(text.split()) or "mark", by))

    def verify(self, claim: str | None, operator: str = "", reason: str | None = None) -> EvidenceRecord:
        """Put the last frame measured on record. Raises RecordingError."""
        frame, results = self._seen()
        by = operator or self._plan.settings.operator
        return self._ask(lambda: self._session().verify(frame, results[-1], claim, by, reason))

    def _seen(self) -> Seen:
        if (newest := self._newest) is None:
            raise RecordingError("no frame has been measured yet; wait for a picture")
        return newest

    def _session(self) -> RunningSession:
        if self._running is None:
            raise RecordingError(self._failure or "nothing is being recorded; start recording first")
        return self._running

    def _ask(self, what: Callable[[], T]) -> T:
        if not self._thread.is_alive() or self._closing.is_set():
            raise RecordingError("the recorder does not run")
        return self._asked.ask(what)

    def _asked_for(self, what: Callable[[], T]) -> T:
        """Do what was asked; where that finds no room, recording is over."""
        try:
            return what()
        except ConfigError as error:
            raise RecordingError(str(error)) from error
        except (OSError, av.FFmpegError) as error:
            if self._running is not None:
                self._fail(error)
            raise RecordingError(_reason(error)) from error

    # -- the thread ----------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._closing.is_set() or (self._waiting and time.monotonic() < self._deadline_s):
            self._guarded(self._step)
        self._guarded(lambda: self._finish("the watch ended"))
        self._asked.serve(self._asked_for)
        self._upkeep.close(0.1)

    @property
    def _waiting(self) -> bool:
        assert self._frames is not None
        return bool(self._frames.depth or self._answers or self._events)

    def _guarded(self, do: Callable[[], object]) -> None:
        """Do something, whose failure ends the recording at most."""
        try:
            do()
        except (OSError, av.FFmpegError, RecordingError) as error:
            self._fail(error)
        except Exception as error:
            log.exception("recorder: a mistake of its own")
            self._fail(error)

    def _step(self) -> None:
        assert self._frames is not None
        self._asked.serve(self._asked_for)
        answered = len(self._answers)
        frame = self._frames.take(WAIT_S)
        if self._running is None:
            self._answers.clear()
            self._events.clear()
        else:
            self._write(self._running, frame, answered if frame is None else 0)
        self._follow_viewer()
        self._upkeep.look(time.monotonic(), None if self._running is None else self._running.folder)
        self._tell_state()
        if frame is None and self._frames.exhausted and not self._waiting:
            self._closing.wait(WAIT_S)

    def _follow_viewer(self) -> None:
        if self._running is not None and self._viewer is not None and time.monotonic() >= self._follow_s:
            self._follow_s = time.monotonic() + FOLLOW_EVERY_S
            self._running.writer.follow_viewer()

    def _write(self, session: RunningSession, frame: Frame | None, settled: int) -> None:
        """Write what there is; frames of the first `settled` answers, where not recorded by now, never will be."""
        assert self._frames is not None
        if overflowed := self._frames.overflowed - self._overflow_told:
            self._overflow_told += overflowed
            session.writer.overflow(overflowed)
        if frame is not None:
            ago_ns = max(0, self._clock.monotonic_ns() - frame.received_ns)
            session.record(frame, self._wall_ns() - ago_ns)
        while self._answers and session.answer(*self._answers[0], no_more_frames=settled > 0):
            self._answers.popleft()
            settled -= 1
        if self._newest is not None:
            session.after_mark(self._newest[0], self._newest[1][-1])
        while self._events:
            kind, text, level, more = self._events.popleft()
            session.writer.event(kind, text, level, **more)

    def _tell_state(self, last: RunningSession | None = None) -> None:
        """Say how it does; `last` is the session that is just over."""
        counted, waiting = self._running or last, 0 if self._frames is None else self._frames.depth
        folder = None if self._running is None else self._running.folder
        if counted is None:
            self._state = replace(self._state, folder=folder, failure=self._failure, waiting=waiting)
            return
        w = counted.writer
        self._state = RecordingState(
            folder, self._failure, w.frames, w.measured, counted.evidence, w.overflowed, waiting, w.folder
        )

    # -- sessions begin and end ----------------------------------------------------------------------------------------

    def _begin_asked(self) -> Path:
        if self._running is not None:
            raise RecordingError(f"is being recorded already, into {self._running.folder}")
        return self._begin(from_start=False)

    def _begin(self, *, from_start: bool) -> Path:
        session = self._plan.begin(self._device, from_start=from_start, wall_ns=self._wall_ns)
        self._answers.clear()
        self._events.clear()
        self._failure = None
        self._overflow_told = 0 if self._frames is None else self._frames.overflowed
        self._running = RunningSession(session, self._wall_ns, awaits_memory=self._remembers and not from_start)
        self._running.writer.event("began", f"recording of {self._plan.what} begins")
        if self._viewer_for is not None:
            viewer = self._viewer_for(self._running.folder / VIEWER)
            viewer.start()
            self._viewer = viewer
        self._tell_state()
        return self._running.folder

    def _finish(self, reason: str) -> Path | None:
        running, self._running = self._running, None
        left_s = max(0.0, self._end_s - time.monotonic())
        ended = self._close_viewer(min(VIEWER_CLOSE_S, left_s / 2))  # the session's own end matters more
        if running is None:
            return None
        if not ended:
            running.writer.forget_viewer()
        try:
            running.writer.close(reason)
        finally:
            self._tell_state(running)
        return running.folder

    def _fail(self, error: Exception) -> None:
        """End the recording for want of room or the like; the watch goes on."""
        running, self._running = self._running, None
        self._failure = f"recording stopped: {_reason(error)}"
        log.error("%s; the watch goes on without it", self._failure)
        if running is not None:
            running.writer.abort(self._failure)
        self._close_viewer(0.2)
        self._tell_state(running)

    def _close_viewer(self, timeout_s: float) -> bool:
        """Close the viewer's file; False where its thread did not end in time."""
        viewer, self._viewer = self._viewer, None
        if viewer is None:
            return True
        viewer.close(timeout_s)
        return not viewer.running


def _reason(error: Exception) -> str:
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        full = "; make room, or set [recording] max_size_gib" if is_full(error) else ""
        return f"{where}{error.strerror or error}{full}"
    return str(error) if isinstance(error, RecordingError | ConfigError) else f"{type(error).__name__}: {error}"
