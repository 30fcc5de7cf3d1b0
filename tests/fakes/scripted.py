"""A grabber that does what its script says, a measurer that does what its test says, a sink that remembers."""

import itertools
import threading
from collections.abc import Iterable

import numpy as np

from drivers.errors import DeviceTimeoutError, EndOfRecordingError
from drivers.frame import Field, Frame, PixelFormat
from drivers.grabber import FrameFormat, Grabber
from service.sinks.base import SinkStats
from service.vision.measurement import Lock, Measurement, Tubes

PATIENCE_S = 60.0
"""How long a test waits for what must happen; never how long it takes."""


def make_frame(sequence=0, *, defect=None, generation=1, received_ns=0, field=Field.PROGRESSIVE, size=(64, 48)):
    pixels = np.zeros((size[1], size[0]), np.uint8)
    pixels.flags.writeable = False
    return Frame(
        pixels,
        sequence,
        (sequence or 0) * 40_000_000,
        received_ns,
        field,
        PixelFormat.MONO8,
        "fake",
        generation,
        defect,
    )


class Hang:
    """A step of a script that blocks, whatever the timeout, until the test lets go."""

    def __init__(self):
        self.entered = threading.Event()
        self.release = threading.Event()

    def __call__(self):
        self.entered.set()
        assert self.release.wait(60)
        return TimeoutError


class ScriptedGrabber(Grabber):
    """Plays a script: an int or a Frame is delivered, an exception is raised, a callable is called for the next step.

    TimeoutError (the class) stands for a read without a frame. At the script's end comes EndOfRecordingError.
    """

    def __init__(self, script: Iterable = (), *, on_open=None, on_close=None, on_start=None, clock=None, rate_hz=25.0):
        super().__init__("fake", clock=clock)
        self.script = iter(script)
        self.on_open, self.on_close, self.on_start = on_open, on_close, on_start
        self.rate_hz = rate_hz
        self.thread_names = set()

    @property
    def format(self):
        return FrameFormat(64, 48, PixelFormat.MONO8, "fake", self.rate_hz)

    def _run_hook(self, hook):
        self.thread_names.add(threading.current_thread().name)
        if isinstance(hook, Exception):
            raise hook
        if hook is not None:
            hook()

    def _do_open(self):
        self._run_hook(self.on_open)

    def _do_close(self):
        self._run_hook(self.on_close)

    def _do_start(self, mode):
        self._run_hook(self.on_start)

    def _do_stop(self):
        pass

    def _do_read(self, timeout_s):
        step = next(self.script, EndOfRecordingError)
        while callable(step) and not isinstance(step, type):
            step = step()
        if step is TimeoutError:
            raise DeviceTimeoutError(self.name, "nothing came")
        if isinstance(step, Exception) or (isinstance(step, type) and issubclass(step, Exception)):
            raise step if isinstance(step, Exception) else step(self.name)
        if isinstance(step, Frame):
            return step
        return make_frame(step, received_ns=self.clock.monotonic_ns(), generation=self.generation)


def idle():
    """An endless run of reads without a frame, not faster than a device's."""
    pause = threading.Event()
    for _ in itertools.count():
        pause.wait(0.005)
        yield TimeoutError


def nothing_found(field="progressive"):
    return Measurement(field, Lock.NONE, "nothing there", (), Tubes.none(), None, 0)


class FakeMeasurer:
    """Answers each picture with no lock; raises, or waits for the test, where told."""

    def __init__(self, answer=None):
        self.answer = answer or (lambda: [nothing_found()])
        self.calls, self.memory = [], {}
        self.resets = 0

    def measure(self, pixels, time_ns, field="unknown"):
        self.calls.append((pixels.shape, time_ns, field))
        return self.answer()

    def recall(self, memory):
        pass

    def settle_index(self, index, shift):
        return True

    def reset(self):
        self.resets += 1


class GatedMeasurer(FakeMeasurer):
    """Measures one picture for each `let`."""

    def __init__(self):
        super().__init__(self._wait)
        self.entered = threading.Semaphore(0)
        self._gate = threading.Semaphore(0)

    def _wait(self):
        self.entered.release()
        assert self._gate.acquire(timeout=60)
        return [nothing_found()]

    def let(self, count=1):
        self._gate.release(count)


class RememberingSink:
    name = "memory"

    def __init__(self, on_start=None, on_accept=None):
        self.on_start, self.on_accept = on_start, on_accept
        self.got, self.started, self.closed = [], 0, 0

    def start(self):
        self.started += 1
        if self.on_start:
            raise self.on_start

    def accept(self, frame, results):
        self.got.append((frame, list(results)))
        if self.on_accept:
            raise self.on_accept

    def close(self, timeout_s):
        self.closed += 1
        self.timeout_s = timeout_s

    def stats(self):
        return SinkStats(accepted=len(self.got))

    @property
    def sequences(self):
        return [frame.sequence for frame, _ in self.got]
