"""A pipeline that wants three times the time there is: capture must not notice, and no frame be old when it begins.

    python -m tests.bench.load [SECONDS]

A simulated 640x480 device at 30 frames a second with eight buffers, as the V4L2 grabber asks for; measuring takes
100 ms of pure Python and OpenCV a frame (300 % of the period), beside it a lossless reader such as the recorder's.
Prints what the device lost through us, and how old frames were when their measuring began.
"""

import sys
import threading
import time

import cv2
import numpy as np

from drivers.scene import CLEAN, GENERATORS
from drivers.simulated import SimulatedGrabber
from drivers.simulation import default_scene
from service.acquisition.live import LiveService
from service.acquisition.recovery import Supervision
from service.config.supervision import SupervisionSettings
from tests.fakes.scripted import FakeMeasurer, nothing_found

RATE_HZ, BUSY_S = 30.0, 0.1
PERIOD_MS = 1000 / RATE_HZ


def busy(seconds: float = BUSY_S):
    """Compute for so long, half of it without letting go of the interpreter."""
    end_s, picture = time.monotonic() + seconds, np.zeros((480, 640), np.uint8)
    while time.monotonic() < end_s:
        sum(i * i for i in range(2000))
        cv2.GaussianBlur(picture, (0, 0), 1.5)
    return [nothing_found()]


def run(seconds: float, measure=busy):
    """The device's own account, the service's health, and the frames a lossless reader got."""
    scene = default_scene(GENERATORS["model-f"], np.random.default_rng(1), rate_hz=RATE_HZ, frames=7, look=CLEAN)
    grabber = SimulatedGrabber(scene, loop_frames=8, buffers=8)
    service = LiveService(
        grabber, lambda _: FakeMeasurer(measure), supervision=Supervision(SupervisionSettings()), oldest_s=1.0
    )
    queue, got = service.subscribe(64), []

    def read():
        while not queue.exhausted:
            if (frame := queue.take(0.5)) is not None:
                got.append(frame.sequence)

    reader = threading.Thread(target=read, name="reader")
    with service:
        service.start()
        reader.start()
        service.wait(seconds)
        service.stop()
        health = service.health()
    reader.join()
    return grabber.record, health, got


def main(seconds: float) -> int:
    record, health, got = run(seconds)
    account, age, interval = health.account, health.age_ms, health.interval_ms
    print(
        f"{account.delivered:,} frames in {seconds:.0f} s, {health.result_fps:.1f} measured a second of {RATE_HZ:.0f}"
    )
    print(f"  lost at the device through us: {record.overrun}; by a lossless reader: {account.delivered - len(got)}")
    print(f"  age when measuring begins: p50 {age.p50:.2f} ms, p99 {age.p99:.2f} ms (aim {PERIOD_MS + 2:.1f})")
    print(f"  interval: p50 {interval.p50:.2f} ms, p99 {interval.p99:.2f} ms")
    print(f"  {account.lines()[1]}")
    return int(record.overrun > 0 or len(got) != account.delivered or not account.balanced())


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 30.0))
