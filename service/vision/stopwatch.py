"""What each stage takes. The clock is the caller's."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Stopwatch"]


class Stopwatch:
    """Adds up the time of named stages."""

    def __init__(self, tick: Callable[[], int]) -> None:
        self._tick = tick
        self._start = self._last = tick()
        self._ns: dict[str, int] = {}

    def lap(self, stage: str) -> None:
        """Count the time since the last lap to `stage`."""
        now = self._tick()
        self._ns[stage] = self._ns.get(stage, 0) + now - self._last
        self._last = now

    def elapsed_ms(self) -> dict[str, float]:
        """Every stage and the total, ms."""
        stages = {stage: ns * 1e-6 for stage, ns in self._ns.items()}
        return {**stages, "total": (self._tick() - self._start) * 1e-6}
