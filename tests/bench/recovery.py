"""How soon the live service notices a device's failure, has frames again, and stops: in real time.

    python -m tests.bench.recovery [ROUNDS]

A simulated 640x480 device at 30 frames a second is unplugged for a while and plugged in again, and stands still, so
many times; then the service is stopped in each state that it can be in, with two sinks to flush.
"""

import logging
import random
import sys
import threading
import time
from dataclasses import dataclass, field

import numpy as np

from drivers.errors import DeviceBusyError
from drivers.faults import Fault, FaultKind
from drivers.scene import CLEAN, GENERATORS
from drivers.simulated import SimulatedGrabber
from drivers.simulation import default_scene
from service.acquisition.live import LiveService
from service.acquisition.recovery import Supervision
from service.config.supervision import SupervisionSettings
from tests.bench.load import busy
from tests.bench.soak import Drawn
from tests.fakes.scripted import FakeMeasurer

RATE_HZ = 30.0
APART = 45
FOREVER = float("inf")


@dataclass
class Timed:
    """When what happened, s."""

    happened: list[tuple[str, float]] = field(default_factory=list)

    def note(self, what: str):
        self.happened.append((what, time.monotonic()))

    def times(self, what: str) -> list[float]:
        return [t for w, t in self.happened if what in w]

    @property
    def frames(self) -> list[float]:
        return [t for w, t in self.happened if w == "frame"]


class TimedGrabber(SimulatedGrabber):
    """Notes each frame, and when the device is unplugged and back."""

    def __init__(self, timed, **options):
        rng = np.random.default_rng(1)
        scene = default_scene(GENERATORS["model-f"], rng, rate_hz=RATE_HZ, frames=7, look=CLEAN)
        super().__init__(scene, loop_frames=8, **options)
        self._timed = timed
        self.hung, self.stuck, self.refused = threading.Event(), threading.Event(), False

    def _do_open(self):
        if self.refused:
            raise DeviceBusyError(self.name, "is taken")
        super()._do_open()

    def _do_read(self, timeout_s):
        if self.stuck.is_set():
            self.hung.wait(30)
        frame = super()._do_read(timeout_s)
        self._timed.note("frame")
        return frame


def served(grabber, timed, *, measure=None, **options) -> LiveService:
    measurer = FakeMeasurer(measure)
    return LiveService(
        grabber,
        lambda _: measurer,
        [Drawn(), Drawn()],
        supervision=Supervision(SupervisionSettings(), rng=random.Random(0)),
        tell=lambda text, _: timed.note(text),
        **options,
    )


def after(marks: list[float], of: list[float]) -> np.ndarray:
    """From each mark to the next of the others, s."""
    return np.array([min(t - mark for t in of if t >= mark) for mark in marks if any(t >= mark for t in of)])


def unplugged(rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """From unplugging to its being noticed, and from the replug to the next frame, s."""
    timed, rng = Timed(), random.Random(1)
    away_s = [rng.uniform(0.3, 3.0) for _ in range(rounds)]
    faults = [Fault(FaultKind.DISCONNECT, APART * (i + 1), seconds=s) for i, s in enumerate(away_s)]
    grabber = TimedGrabber(timed, faults=faults)
    gone: list[float] = []

    def watch_device():  # the device's own time of its unplugging, before anybody has read it
        seen = 0.0
        while not over.wait(0.001):
            back_ns = grabber._device.gone_until_ns
            if back_ns is not None and back_ns != seen:
                seen = back_ns
                gone.append(back_ns / 1e9)

    over = threading.Event()
    watcher = threading.Thread(target=watch_device, name="watcher")
    with served(grabber, timed) as service:
        service.start()
        watcher.start()
        while service.health().recoveries < rounds:
            assert not service.wait(0.1)
        over.set()
        watcher.join()
    back = np.array(gone)
    left = [b - away for b, away in zip(back, away_s, strict=True)]
    return after(left, timed.times("was unplugged")), after(list(back), timed.frames)


def stalled(rounds: int) -> np.ndarray:
    """From the last frame to the stall's being noticed, s."""
    timed = Timed()
    faults = [Fault(FaultKind.HANG, APART * (i + 1), seconds=FOREVER) for i in range(rounds)]
    with served(TimedGrabber(timed, faults=faults), timed) as service:
        service.start()
        while service.health().recoveries < rounds:
            assert not service.wait(0.1)
    frames = timed.frames
    return np.array([noticed - max(t for t in frames if t < noticed) for noticed in timed.times("no frame for")])


def stops() -> dict[str, float]:
    """Time that a stop takes, in each state, s."""
    taken = {}

    def stop(what: str, service: LiveService):
        began = time.monotonic()
        service.stop()
        taken[what] = time.monotonic() - began

    def begun(measure=None, wait_s=0.5, **options):
        grabber = TimedGrabber(Timed(), **options)
        service = served(grabber, Timed(), measure=measure)
        service.start()
        service.wait(wait_s)
        return grabber, service

    not_begun = served(TimedGrabber(Timed()), Timed())
    not_begun.open()
    stop("open, not begun", not_begun)
    stop("streaming", begun()[1])
    stop("measuring at 300 %", begun(busy)[1])
    stop("unplugged", begun(wait_s=1.5, faults=[Fault(FaultKind.DISCONNECT, 5, seconds=600)])[1])
    stop("stalled", begun(wait_s=0.4, faults=[Fault(FaultKind.HANG, 5, seconds=FOREVER)])[1])
    grabber, service = begun(faults=[Fault(FaultKind.DISCONNECT, 30)])
    grabber.refused = True
    service.wait(3.0)
    stop("backing off", service)
    grabber, service = begun()
    grabber.stuck.set()
    service.wait(0.5)
    stop("device hung", service)
    grabber.hung.set()
    service.wait(5.0)
    hold = threading.Event()
    _, service = begun(lambda: hold.wait(30) and [])
    stop("measuring hung", service)
    hold.set()
    service.wait(5.0)
    return taken


def show(what: str, values_s: np.ndarray, aim_s: float):
    p50, most = np.percentile(values_s, 50), values_s.max()
    print(f"{what:34} p50 {p50:6.3f}  max {most:6.3f} s  (aim {aim_s:g}; {len(values_s)} times)")


def main(rounds: int) -> None:
    logging.getLogger("service").setLevel(logging.CRITICAL)
    noticed, again = unplugged(rounds)
    show("unplug noticed", noticed, 0.2)
    show("first frame after a replug", again, 3.0)
    show("stall noticed", stalled(rounds), 0.5)
    for state, seconds in stops().items():
        show(f"stop: {state}", np.array([seconds]), 2.0)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
