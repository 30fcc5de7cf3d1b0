"""Frames through the live service from a device that goes wrong all the time: every one must be accounted for.

    python -m tests.bench.faults [FRAMES] [SEED]

The device is simulated, in a time that nobody waits for; the service is the real one, with its threads, recovery and
ledger. Prints what struck and what became of the frames; fails unless the ledger balances and agrees with the device.
"""

import logging
import random
import sys
import threading
import time

import numpy as np

from drivers.faults import Fault, random_faults
from drivers.grabber import FieldMode
from drivers.scene import CLEAN, GENERATORS
from drivers.simulated import SimulatedGrabber
from drivers.simulation import default_scene
from service.acquisition.ledger import Account
from service.acquisition.live import LiveService
from service.acquisition.recovery import Supervision
from service.config.supervision import SupervisionSettings
from tests.fakes.clock import ManualClock
from tests.fakes.scripted import FakeMeasurer

SHARE = 0.01
PATIENCE_S = 3600.0
LOOP_FRAMES = 8
MOST_SECONDS = 2.0
LATE_SHARE, LATE_S = 0.001, 0.5


class CountingGrabber(SimulatedGrabber):
    """Says when its device has exposed so many frames; now and then its reader is late."""

    def __init__(self, scene, frames, late_share=0.0, **kwargs):
        super().__init__(scene, loop_frames=LOOP_FRAMES, **kwargs)
        self._enough, self.reached = frames, threading.Event()
        self._late_share, self._late = late_share, random.Random(0)

    def _do_read(self, timeout_s):
        if self.record.exposed >= self._enough:
            self.reached.set()
        if self._late.random() < self._late_share:
            self.clock.advance(self._late.uniform(0, LATE_S))
        return super()._do_read(timeout_s)


def tiny_scene(**options):
    rng = np.random.default_rng(1)
    return default_scene(GENERATORS["model-f"], rng, size_px=(32, 24), frames=LOOP_FRAMES - 1, look=CLEAN, **options)


def run(faults: tuple[Fault, ...], frames: int, *, settings=None, patience_s=PATIENCE_S, tell=None, **options):
    """Let a device with these faults expose so many frames; gives the grabber, the service's account and events.

    With `tell`, that gets the events, and none are kept.
    """
    grabber = CountingGrabber(tiny_scene(), frames, faults=faults, clock=ManualClock(), **options)
    events = []
    service = LiveService(
        grabber,
        lambda _: FakeMeasurer(),
        supervision=Supervision(settings or SupervisionSettings()),
        oldest_s=1.0,
        tell=tell or (lambda *event: events.append(event)),
    )
    with service:
        service.start()
        assert grabber.reached.wait(patience_s), f"{grabber.record.exposed} of {frames} frames only"
        service.stop()
        health = service.health()
    assert not service.stuck
    assert service.failure is None
    check(health.account, grabber)
    return grabber, health, events


def check(account: Account, grabber: SimulatedGrabber):
    """Fail unless every frame is accounted for, by the ledger and by the device."""
    r = grabber.record
    assert account.balanced(), account
    assert account.in_flight == 0, account
    if grabber.field_mode is FieldMode.ALTERNATE:  # two of each reading, unless it was unplugged between them
        assert 2 * r.delivered - 2 * r.struck.total() <= account.delivered <= 2 * r.delivered, (account, r)
    else:
        assert account.delivered == r.delivered, (account, r)
        assert account.span - account.lost == r.delivered - r.repeated, (account, r)
    assert account.lost <= r.dropped + r.overrun, (account, r)


def main(frames: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    logging.getLogger("service").setLevel(logging.CRITICAL)  # tens of thousands of events
    faults = random_faults(rng, frames, SHARE, most_seconds=MOST_SECONDS)
    began = time.perf_counter()
    grabber, health, _ = run(faults, frames, late_share=LATE_SHARE)
    seconds = time.perf_counter() - began
    struck = ", ".join(f"{count:,} {kind}" for kind, count in sorted(grabber.record.struck.items()))
    print(f"{frames:,} frames with {grabber.record.struck.total():,} faults in {seconds:.0f} s, seed {seed}: {struck}")
    for line in health.account.lines():
        print(f"  {line}")
    print(f"  {grabber.record.overrun:,} overrun because the reader was late")
    print(f"  {health.recoveries:,} recoveries, generation {health.generation:,}")
    print(f"  {health.account.unaccounted} unaccounted")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
