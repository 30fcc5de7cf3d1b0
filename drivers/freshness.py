"""Whether a picture is a fresh one, for sources that do not number theirs: pure of clocks, by what they are told."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from drivers.frame import Pixels

__all__ = ["Freshness"]

STALE_PERIODS: Final = 2.5
WAITED_PERIODS: Final = 0.25
"""A picture that was waited for at least so long had not been there."""


class Freshness:
    """Looks at the pictures of one stream, in their order.

    Parameters
    ----------
    period_ns
        From picture to picture.
    now_ns
        When the stream is started.
    """

    def __init__(self, period_ns: int, now_ns: int) -> None:
        self._period_ns = period_ns
        self._least_age_ns = math.inf
        self._last: tuple[Pixels, int | None] | None = None
        self.want(now_ns)

    def want(self, now_ns: int) -> None:
        """From now on: what was taken before is old."""
        self._wanted_from_ns = self._taken_ns = now_ns
        self._kept = True

    def is_fresh(self, stamp_ns: int | None, began_ns: int, now_ns: int) -> bool:
        """Whether a picture is not old.

        By its own time it is, where it is hardly later than pictures of this stream ever were, and not from before
        it was wanted. Without one it is old where it came at once after a pause, a start or a trigger: it had waited.

        Parameters
        ----------
        stamp_ns
            When it was taken; None where that is not told.
        began_ns, now_ns
            When it was asked for, and when it was there.
        """
        if stamp_ns is not None:
            self._least_age_ns = min(self._least_age_ns, now_ns - stamp_ns)
            late_ns = now_ns - stamp_ns - self._least_age_ns
            return late_ns <= STALE_PERIODS * self._period_ns and stamp_ns >= self._wanted_from_ns - self._period_ns
        paused = self._kept or began_ns - self._taken_ns > STALE_PERIODS * self._period_ns
        return not paused or now_ns - began_ns > WAITED_PERIODS * self._period_ns

    def take(self, now_ns: int) -> None:
        """Take note that a picture was taken."""
        self._taken_ns, self._kept = now_ns, False

    def repeats(self, pixels: Pixels, stamp_ns: int | None) -> bool:
        """Whether it is the picture before once more: of the same time, or of none, and the same to the last bit."""
        before, self._last = self._last, (pixels, stamp_ns)
        return before is not None and before[1] == stamp_ns and np.array_equal(before[0], pixels)
