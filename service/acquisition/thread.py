"""The thread that owns a grabber: opens it, reads it, gets it back when it fails, never waits for anyone downstream."""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
from typing import TYPE_CHECKING, Final

from drivers.errors import (
    ConfigError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceNotFoundError,
    DeviceStateError,
    DeviceTimeoutError,
    EndOfRecordingError,
)
from service.acquisition.content import NO_SIGNAL_WORDS, frozen, no_picture
from service.acquisition.health import AcquisitionState
from service.acquisition.ladder import Rung
from service.acquisition.tell import Tell
from service.acquisition.watchdog import is_stalled, silence_limit_s
from service.config.supervision import SupervisionSettings
from service.precedence import go_first

if TYPE_CHECKING:
    from drivers.frame import Frame
    from drivers.grabber import Clock, FrameFormat
    from service.acquisition.device import Device
    from service.acquisition.intake import Intake
    from service.acquisition.ladder import Step
    from service.acquisition.recovery import Recovery

__all__ = ["AcquisitionThread"]

log = logging.getLogger(__name__)

READ_TIMEOUT_S: Final = 0.1
LOOK_S: Final = 1.0
"""How often the device is asked for its signal and input."""
MOST_DOUBLINGS: Final = 6
"""Of the time after which a frozen picture has its source restarted: where that does not help, it seldom will."""
PAUSE_S: Final = 0.05
"""Longest single sleep: how soon a pause ends when a stop is asked for."""
UNSUPERVISED: Final = SupervisionSettings()


class AcquisitionThread:
    """Reads a grabber from `open` until stopped, or until it ends or fails for good.

    Parameters
    ----------
    device
        Closed; from `open` on only this thread calls it.
    intake
        Where its frames go.
    tell
        Says what happens to it.
    recovery
        Gets it back when it fails; None: every failure is final, as with recordings.
    takes_over
        In words, the call that the thread before this one is stuck in: goes on in its place, with another grabber.
    """

    def __init__(
        self,
        device: Device,
        intake: Intake,
        tell: Tell | None = None,
        recovery: Recovery | None = None,
        takes_over: str | None = None,
    ) -> None:
        self.device, self._intake, self._recovery = device, intake, recovery
        self._tell = tell or Tell(device.name)
        self._settings = UNSUPERVISED if recovery is None else recovery.settings
        self._takes_over = takes_over
        self._clock: Clock = device.clock
        self._stop = threading.Event()
        self._opened = threading.Event()
        self._begin = threading.Event()
        self._done = threading.Event()
        self._owning = threading.Lock()
        self._left_behind = False
        self._inputs_asked: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._look_ns = 0
        self._told: tuple[type[Exception], Rung] | None = None
        self._thread = threading.Thread(target=self._run, name="bowlsight-acquisition", daemon=True)
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
            raise DeviceTimeoutError(self.device.name, f"did not open within {timeout_s:g} s; is the device hung?")
        if self.failure is not None:
            raise self.failure
        assert self.device.format is not None
        return self.device.format

    def take_over(self) -> None:
        """Start the thread where the one before it is stuck."""
        self._begin.set()
        self._thread.start()

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

    def leave_behind(self) -> None:
        """Take nothing from it any more; it ends, and lets its device go, when the call that it is stuck in returns."""
        with self._owning:
            self._left_behind = True
        self.request_stop()

    def ask_for_input(self, name: str) -> None:
        """Have the device switched to another input before its next frame is read."""
        self._inputs_asked.put(name)

    # -- the thread itself ---------------------------------------------------------------------------------------------

    def _run(self) -> None:
        go_first()
        try:
            self._acquire()
            self.state = AcquisitionState.CLOSED
        except EndOfRecordingError:
            self.state = AcquisitionState.ENDED
        except DeviceDisconnectedError as error:
            self._fail(AcquisitionState.LOST, error)
        except (DeviceError, ConfigError) as error:
            self._fail(AcquisitionState.FAULTED, error)
        except Exception as error:  # whatever a driver does, the service ends in order
            log.exception("%s: the driver failed in a way it does not announce", self.device.name)
            self._fail(AcquisitionState.FAULTED, error)
        finally:
            self._let_go()

    def _fail(self, state: AcquisitionState, error: Exception) -> None:
        self.failure, self.state = error, state
        if self._recovery is not None:
            self._recovery.trouble = ""

    def _acquire(self) -> None:
        if self._takes_over is None:
            self._open()
        self._opened.set()
        while not self._begin.wait(1.0):
            pass
        step = self._first_step()
        while not self._stop.is_set():
            try:
                if step is not None and self._paused(step.pause_s):
                    self._climb(step)
                if not self._stop.is_set():
                    self._stream()
            except Exception as error:  # noqa: BLE001 - whatever a driver raises, its device is tried again
                if self._stop.is_set():  # what failed on the way out matters to nobody
                    return
                step = self._next_step(error)

    def _first_step(self) -> Step | None:
        if self._takes_over is None or self._recovery is None:
            return None
        self._tell(f"{self._takes_over} does not return; it is left behind, and the device opened anew", "ERROR")
        self.state = AcquisitionState.BACKING_OFF
        return self._recovery.after_hang(f"{self._takes_over} does not return")

    def _open(self) -> None:
        before = self.device.format
        self._tell_of_format(before, self.device.open())

    def _tell_of_format(self, before: FrameFormat | None, now: FrameFormat) -> None:
        if before is not None and (before.width_px, before.height_px) != (now.width_px, now.height_px):
            self._tell(
                f"its pictures are {now.width_px}x{now.height_px} px now; they were "
                f"{before.width_px}x{before.height_px} px"
            )

    def _stream(self) -> None:
        """Start, and read until something goes wrong or a stop is asked for."""
        self._intake.begin_stream(self.device.generation)
        if self._recovery is not None:
            self._recovery.begin_stream()
        self.device.start()
        self._look_ns = 0
        while not self._stop.is_set():
            self._read_once()

    def _read_once(self) -> None:
        frame = self.device.read(self._patience_s())
        if frame is not None:
            self._take(frame)
        self._switch_as_asked()
        if self._recovery is not None and self._clock.monotonic_ns() >= self._look_ns:
            self._look()
        if frame is None:
            self._check_silence()

    def _patience_s(self) -> float:
        """How long to wait for a frame: no longer than until its absence is to be noticed."""
        last_ns, limit_s = self._silence()
        left_s = limit_s - (self._clock.monotonic_ns() - last_ns) / 1e9
        return left_s if 0.0 < left_s < READ_TIMEOUT_S else READ_TIMEOUT_S

    def _take(self, frame: Frame) -> None:
        with self._owning:
            if self._left_behind:
                return
            self._intake.take(frame)
        assert self._intake.last is not None, "just taken"
        bad = self._intake.last.bad
        self.state = AcquisitionState.DEGRADED if bad else AcquisitionState.RUNNING
        if self._recovery is None:
            return
        if (words := self._recovery.frame(bad=bad)) is not None:
            self._told = None
            self._tell(f"{words}; generation {self._intake.generation}", "INFO")
        if bad:
            self._check_frozen()

    # -- what goes wrong without an error ------------------------------------------------------------------------------

    def _check_silence(self) -> None:
        last_ns, limit_s = self._silence()
        if not is_stalled(self._clock.monotonic_ns(), last_ns, limit_s):
            return
        self.state = AcquisitionState.STALLED
        if self._recovery is not None and not self._is_without_signal():
            raise DeviceTimeoutError(self.device.name, f"no frame for {limit_s:.1f} s")

    def _silence(self) -> tuple[int, float]:
        """Since when there is no frame, and how long that may be."""
        last = self._intake.last
        assert last is not None, "the stream began"
        rate_hz = None if self.device.format is None else self.device.format.rate_hz
        return last.time_ns, silence_limit_s(self._settings, rate_hz, started=last.started)

    def _is_without_signal(self) -> bool:
        """Whether the device says why it gives no frames: then it is well, and waits for its signal as we do."""
        self._look()
        watch = self._intake.watch
        return watch is not None and watch.content.signal in NO_SIGNAL_WORDS

    def _check_frozen(self) -> None:
        watch, settings = self._intake.watch, self._settings
        if self._recovery is None or watch is None or no_picture(watch.content, settings.frozen_frames):
            return
        frozen_s = (self._clock.monotonic_ns() - watch.content.same_since_ns) / 1e9
        patience_s = settings.frozen_restart_s * 2.0 ** min(self._recovery.failures, MOST_DOUBLINGS)
        if frozen(watch.content, settings.frozen_frames) and frozen_s > patience_s:
            raise DeviceTimeoutError(self.device.name, f"its picture has been frozen for {frozen_s:.0f} s")

    def _look(self) -> None:
        """Ask the device for its signal, and whether it is still switched to the input that it was given."""
        self._look_ns = self._clock.monotonic_ns() + int(LOOK_S * 1e9)
        expected, (signal, now) = self.device.input, self.device.look()
        if self._intake.watch is not None:
            self._intake.watch.signalled(signal)
        if now != expected and expected is not None:
            self._tell(f"somebody switched it to input {now}; switching back to {expected}")
            self._switch(expected)

    def _switch_as_asked(self) -> None:
        with contextlib.suppress(queue.Empty):
            name = self._inputs_asked.get_nowait()
            try:
                self._switch(name)
            except DeviceStateError as error:
                self._tell(str(error))
            else:
                self._tell(f"switched to input {name}", "INFO")

    def _switch(self, name: str) -> None:
        self.device.select_input(name)
        self._intake.begin_view()
        self._look_ns = 0

    # -- getting it back -----------------------------------------------------------------------------------------------

    def _next_step(self, error: Exception) -> Step:
        """What to try next; raises the error where trying again cannot help, or nobody wants it."""
        step = None
        if self._recovery is not None and not isinstance(error, EndOfRecordingError):
            step = self._recovery.after(error, streams=self.device.streams)
        if step is None:
            raise error
        if not isinstance(error, DeviceError):
            log.error("%s: the driver failed in a way it does not announce", self.device.name, exc_info=error)
        gone = isinstance(error, (DeviceDisconnectedError, DeviceNotFoundError))
        self.state = AcquisitionState.LOST if gone else AcquisitionState.BACKING_OFF
        if (kind := (type(error), step.rung)) != self._told:  # the same again and again is told once
            self._told = kind
            self._tell(f"{error}; {step.rung.words}")
        return step

    def _paused(self, seconds: float) -> bool:
        """Wait; False where a stop was asked for."""
        end_ns = self._clock.monotonic_ns() + round(seconds * 1e9)
        while (left_s := (end_ns - self._clock.monotonic_ns()) / 1e9) > 0 and not self._stop.is_set():
            self._clock.sleep(min(left_s, PAUSE_S))
        return not self._stop.is_set()

    def _climb(self, step: Step) -> None:
        """Bring the device to where it can be started."""
        if step.rung is Rung.RESTART:
            self.device.stop()
            return
        self.device.close()
        if step.rung is Rung.RESET and self._recovery is not None:
            self.device.reset(self._recovery.reset)
        self._open()

    def _let_go(self) -> None:
        try:
            self.device.close()
        except Exception:
            log.exception("%s: closing failed", self.device.name)
        with self._owning:
            if not self._left_behind:
                self._intake.close()
        self._opened.set()
        self._done.set()
