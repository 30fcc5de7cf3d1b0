"""Time that moves only when a test says so, or faster where it says so."""

import time


class ManualClock:
    def __init__(self, now_ns: int = 1_000_000_000):
        self.now_ns = now_ns

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.advance(max(0.0, seconds))

    def advance(self, seconds: float) -> None:
        self.now_ns += int(seconds * 1e9)


class HurriedClock:
    """The machine's time, and what a test advances it by."""

    def __init__(self):
        self.ahead_ns = 0

    def monotonic_ns(self) -> int:
        return time.monotonic_ns() + self.ahead_ns

    def sleep(self, seconds: float) -> None:
        time.sleep(max(0.0, seconds))

    def advance(self, seconds: float) -> None:
        self.ahead_ns += int(seconds * 1e9)
