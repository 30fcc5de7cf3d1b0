"""Time that moves only when a test says so."""


class ManualClock:
    def __init__(self, now_ns: int = 1_000_000_000):
        self.now_ns = now_ns

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.advance(max(0.0, seconds))

    def advance(self, seconds: float) -> None:
        self.now_ns += int(seconds * 1e9)
