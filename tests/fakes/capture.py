"""OpenCV's VideoCapture as it was seen to behave: it keeps old pictures, numbers nothing, and stays open for ever."""

from collections import deque

import cv2
import numpy as np

KEPT = 4
PERIOD_NS = 40_000_000


def picture(number: int, size_px=(64, 48)) -> np.ndarray:
    """(height, width) uint8 of this frame and no other."""
    width, height = size_px
    return np.random.default_rng(number).integers(0, 256, (height, width), np.uint8)


class FakeVideoCapture:
    """A camera with a new picture every 40 ms.

    Faults, by the number of the picture: repeat (the one before, with its time), static (the one before, with a new
    time), broken (grab fails), raises, undecodable, resized.
    """

    def __init__(
        self,
        clock,
        *,
        backend="V4L2",
        stamped=True,
        opens=True,
        size_px=(64, 48),
        grey=False,
        faults=None,
        latency_ns=0,
    ):
        self.clock, self.backend, self.stamped, self.opens = clock, backend, stamped, opens
        self.size_px, self.grey, self.faults = size_px, grey, faults or {}
        self.asked, self.latency_ns = {}, latency_ns
        self.released = 0
        self.began_ns = self.last = None
        self.broken = False
        self.grabbed = False
        """Until what was grabbed is retrieved, nothing else is."""
        self.ticks = 0
        self.kept: deque[tuple[int, int]] = deque()

    def isOpened(self):  # noqa: N802 - OpenCV's spelling
        return self.opens

    def release(self):
        self.released += 1
        self.broken = self.grabbed = False
        self.began_ns = None
        self.kept.clear()

    def getBackendName(self):  # noqa: N802 - OpenCV's spelling
        return self.backend

    def set(self, key, value):
        self.asked[key] = value
        return True

    def get(self, key):
        width, height = self.size_px
        told = {
            cv2.CAP_PROP_FRAME_WIDTH: width,
            cv2.CAP_PROP_FRAME_HEIGHT: height,
            cv2.CAP_PROP_FPS: 25.0,
            cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*"YUYV"),
            cv2.CAP_PROP_POS_MSEC: self.last[1] / 1e6 if self.stamped and self.last else 0.0,
        }
        return float(told.get(key, 0.0))

    def _catch_up(self):
        while not self.broken and (due_ns := self.next_ns()) <= self.clock.now_ns:
            self.broken = self.faults.get(self.ticks) == "broken"
            if len(self.kept) < KEPT and not self.broken:
                fault = self.faults.get(self.ticks)
                past = self.kept[-1] if self.kept else self.last
                number = past[0] if fault in ("repeat", "static") else self.ticks
                self.kept.append((number, past[1] if fault == "repeat" else due_ns - self.latency_ns))
            self.ticks += 1

    def next_ns(self) -> int:
        if self.began_ns is None:
            self.began_ns, self.ticks = self.clock.now_ns, 0
        return self.began_ns + (self.ticks + 1) * PERIOD_NS

    @staticmethod
    def waitAny(captures, timeout_ns):  # noqa: N802 - OpenCV's spelling
        ((fake,)) = captures
        fake._catch_up()
        if fake.faults.get(fake.ticks) == "raises":
            raise cv2.error("Error is reported by camera stream: 0")
        if not fake.grabbed and not fake.kept and not fake.broken and fake.next_ns() - fake.clock.now_ns > timeout_ns:
            fake.clock.now_ns += timeout_ns
            return False, []
        fake.grab()
        return True, [0]

    def grab(self):
        if self.grabbed:
            return True
        self._catch_up()
        if not self.kept and not self.broken:
            self.clock.now_ns = self.next_ns()
            self._catch_up()
        if self.broken and not self.kept:
            return False
        self.last, self.grabbed = self.kept.popleft(), True
        return True

    def retrieve(self):
        self.grabbed = False
        fault = self.faults.get(self.last[0])
        if fault == "undecodable":
            return False, None
        grey = picture(self.last[0], (32, 24) if fault == "resized" else self.size_px)
        return True, grey if self.grey else cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
