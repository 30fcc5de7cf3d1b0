"""What a device's timestamps are worth."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import Final

__all__ = ["StampCheck", "TimeGaps"]

OTHER_CLOCK_NS: Final = 1_000_000_000
"""Further ahead of the clock than this is another clock's time."""
PERIODS: Final = 9


class StampCheck:
    """Sets a device's clock back where it runs ahead: no frame was exposed after it arrived.

    All times of a stream are set back by as much as one of them was ever seen ahead, so the intervals stay.
    """

    def __init__(self) -> None:
        self._ahead_ns = 0

    def restart(self) -> None:
        """Forget the past: a stream begins."""
        self._ahead_ns = 0

    def check(self, stamp_ns: int, received_ns: int) -> int:
        """Give the time to believe, never after `received_ns`; that itself for times of another clock."""
        ahead_ns = stamp_ns - received_ns
        if stamp_ns <= 0 or ahead_ns > OTHER_CLOCK_NS:
            return received_ns
        self._ahead_ns = max(self._ahead_ns, ahead_ns)
        return stamp_ns - self._ahead_ns


class TimeGaps:
    """Finds frames that went missing without a gap in the numbers: some devices number only what they deliver."""

    def __init__(self) -> None:
        self._periods: deque[float] = deque(maxlen=PERIODS)
        self._last: tuple[int, int] | None = None

    def restart(self) -> None:
        """Forget the past: a stream begins."""
        self._periods.clear()
        self._last = None

    def missing(self, sequence: int, stamp_ns: int) -> int:
        """Give how many more frames than the numbers say had time to pass since the frame before.

        Measured by the usual interval of late, not by the rate agreed on: in the dark cameras slow down.
        """
        if self._last is None or sequence <= self._last[0]:
            self._last = self._last or (sequence, stamp_ns)
            return 0
        steps, passed_ns = sequence - self._last[0], stamp_ns - self._last[1]
        self._last = sequence, stamp_ns
        usual_ns = median(self._periods) if len(self._periods) == PERIODS else 0
        self._periods.append(passed_ns / steps)
        return max(0, round(passed_ns / usual_ns) - steps) if usual_ns > 0 else 0
