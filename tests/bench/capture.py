"""How long a frame takes from the device to the reader: waking up, and copying.

    python -m tests.bench.capture [SECONDS]

Waking up is measured with the real grabber on the real poll(2): another process writes frames into a pipe, 30 a second,
each with its time; the grabber's time for it, less that, is what is printed. Once on an idle interpreter, once beside a
thread that computes in pure Python, as the live service runs (switch interval 0.5 ms) and as Python comes (5 ms).
"""

import os
import select
import struct
import subprocess
import sys
import threading
import time
from collections import deque

import numpy as np

from drivers.encodings import ENCODINGS, Layout, picture
from drivers.grabber import SystemClock
from drivers.pool import FramePool
from drivers.v4l2.calls import LinuxCalls
from drivers.v4l2.constants import BufferFlag, FieldOrder
from drivers.v4l2.grabber import V4l2Grabber
from tests.fakes.kernel import PROGRESSIVE, FakeDevice, FakeInput, FakeKernel

RECORD = struct.Struct("=QQ")
RATE_HZ = 30
PRODUCER = """
import os, struct, sys, time
due = time.monotonic()
for number in range(int(sys.argv[2])):
    due += 1 / float(sys.argv[1])
    time.sleep(max(0.0, due - time.monotonic()))
    os.write(1, struct.pack("=QQ", number, time.monotonic_ns()))
"""


class PipedDevice(FakeDevice):
    """A camera whose frames come when another process writes them."""

    def catch_up(self, now_ns: int):
        """Time does nothing here."""

    def _dqbuf(self, fd, a, now_ns):
        if not select.select([self.pipe], [], [], 0)[0]:
            self._refuse(11)
        number, stamp_ns = RECORD.unpack(os.read(self.pipe, RECORD.size))
        a.index, a.sequence = self.queued.popleft(), number
        a.bytesused, a.field, a.flags = self.size[0] * self.size[1], FieldOrder.NONE, BufferFlag.TIMESTAMP_MONOTONIC
        a.timestamp.tv_sec, a.timestamp.tv_usec = divmod(stamp_ns // 1000, 1_000_000)


class PipedKernel(FakeKernel):
    """Waits on the pipe with the real poll."""

    def poll(self, fd: int, timeout_s: float) -> int:
        return LinuxCalls().poll(self.fds[fd].pipe, timeout_s)


class NowClock(SystemClock):
    now_ns = 0


def latencies_ms(seconds: float) -> np.ndarray:
    """Times from a frame to the reader, ms, over so many seconds."""
    frames = int(seconds * RATE_HZ)
    device = PipedDevice(inputs=[FakeInput("Camera", std=0)], size=(640, 480), most=(640, 480), fields=PROGRESSIVE)
    producer = subprocess.Popen(
        [sys.executable, "-c", PRODUCER, str(RATE_HZ), str(frames)], stdout=subprocess.PIPE, bufsize=0
    )
    device.pipe = producer.stdout.fileno()
    clock = NowClock()
    found = deque()
    with V4l2Grabber("/dev/video0", system=PipedKernel(clock, {"/dev/video0": device}), clock=clock) as grabber:
        grabber.start()
        for _ in range(frames):
            frame = grabber.read(5.0)
            found.append((frame.received_ns - frame.timestamp_ns) / 1e6)
    producer.wait(10)
    producer.stdout.close()
    return np.array(found)


def beside_a_load(seconds: float, switch_s: float) -> np.ndarray:
    over, before = threading.Event(), sys.getswitchinterval()

    def compute():
        total = 0
        while not over.is_set():
            total = sum(i * i for i in range(1000)) + total % 7

    load = threading.Thread(target=compute, name="load")
    sys.setswitchinterval(switch_s)
    load.start()
    try:
        return latencies_ms(seconds)
    finally:
        over.set()
        load.join()
        sys.setswitchinterval(before)


def show(title: str, values: np.ndarray, unit: str):
    p50, p99 = np.percentile(values, [50, 99])
    print(f"{title:46} p50 {p50:7.3f}  p99 {p99:7.3f}  max {values.max():7.3f} {unit}  ({len(values)})")


def copy_us(encoding: str, size_px: tuple[int, int], rounds: int = 300) -> np.ndarray:
    """Times of one copy out of a device's buffer, us."""
    width, height = size_px
    known = ENCODINGS[encoding]
    layout = Layout(width, height, width * known.bytes_per_px, known)
    dtype = np.uint8 if known.dtype == "u1" else np.uint16
    data, pool = (
        np.random.default_rng(0).integers(0, 256, layout.size_bytes, np.uint8),
        FramePool((height, width), dtype, 16),
    )
    times = []
    for _ in range(rounds):
        began = time.perf_counter_ns()
        picture(data, layout, pool, "bench")
        times.append((time.perf_counter_ns() - began) / 1e3)
    return np.array(times)


def fresh_copy_us(size_px: tuple[int, int], rounds: int = 300) -> np.ndarray:
    """Times of a copy into new memory, as `.copy()` makes it where the frame before is still held, us."""
    source, held, times = np.zeros(size_px[::-1], np.uint8) + 1, deque(maxlen=8), []
    for _ in range(rounds):
        began = time.perf_counter_ns()
        held.append(source.copy())
        times.append((time.perf_counter_ns() - began) / 1e3)
    return np.array(times)


def main(seconds: float):
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    show("wake-up, idle", latencies_ms(seconds), "ms")
    show("wake-up beside pure Python, switching at 0.5 ms", beside_a_load(seconds, 0.0005), "ms")
    show("wake-up beside pure Python, switching at 5 ms", beside_a_load(seconds, 0.005), "ms")
    for encoding, size in [
        ("GREY", (640, 480)), ("GREY", (1280, 720)), ("YUYV", (640, 480)), ("YUYV", (1280, 720)), ("Y16", (640, 480)),
    ]:  # fmt: skip
        show(f"copy {encoding} {size[0]}x{size[1]}", copy_us(encoding, size), "us")
    show("a fresh .copy() GREY 1280x720", fresh_copy_us((1280, 720)), "us")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
