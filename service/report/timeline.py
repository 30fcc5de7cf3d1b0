"""Hours of figures in a few hundred steps of time, without losing what was short: lowest and highest of each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["STEPS", "Envelope", "Presence", "Steps", "days"]

STEPS: Final = 600
FRAMES_A_STEP: Final = 4
"""At least, in the mean: else what is drawn is the source's own pace."""
JOINED_NS: Final = 1_000_000_000
"""Values at most this far apart are one line."""


def days(wall_ns: float) -> float:
    """Days since 1970 of UTC in ns: how plots take times."""
    return wall_ns / 86_400e9


@dataclass(frozen=True, slots=True)
class Steps:
    """A session's time, divided.

    Attributes
    ----------
    began_ns, ended_ns
        UTC, since 1970.
    count
        How many steps.
    """

    began_ns: int
    ended_ns: int
    count: int

    @property
    def width_ns(self) -> float:
        """How long one is; at least 1 us."""
        return max(1000.0, (self.ended_ns - self.began_ns) / self.count)

    @classmethod
    def of(cls, began_ns: int, ended_ns: int, frames: int) -> Steps:
        """Divide a session's time."""
        return cls(began_ns, max(began_ns, ended_ns), min(STEPS, max(1, frames // FRAMES_A_STEP)))

    def at(self, wall_ns: int) -> int:
        """Which one a time is in; the first or the last where it is outside."""
        return min(self.count - 1, max(0, int((wall_ns - self.began_ns) / self.width_ns)))

    @property
    def middles(self) -> NDArray[np.float64]:
        """Middle of each step, UTC, in days since 1970."""
        return np.asarray(days(self.began_ns) + (np.arange(self.count) + 0.5) * days(self.width_ns))


class Envelope:
    """Lowest, highest and mean value of each step."""

    def __init__(self, steps: Steps) -> None:
        self._steps = steps
        self._low, self._high = np.full(steps.count, np.inf), np.full(steps.count, -np.inf)
        self._sum, self._values = np.zeros(steps.count), np.zeros(steps.count, np.int64)

    def add(self, step: int, value: float | None) -> None:
        """Take a value; None is none."""
        if value is not None:
            self._low[step], self._high[step] = min(self._low[step], value), max(self._high[step], value)
            self._sum[step] += value
            self._values[step] += 1

    @property
    def empty(self) -> bool:
        """Whether there is no value at all."""
        return not self._values.any()

    @property
    def extremes(self) -> tuple[float, float]:
        """Lowest and highest of all values."""
        return float(self._low.min()), float(self._high.max())

    def lines(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Times, lowest, highest and mean, with NaN wherever there was no value for a while."""
        filled = np.flatnonzero(self._values)
        apart = max(1.5, JOINED_NS / self._steps.width_ns)
        breaks = np.flatnonzero(np.diff(filled) > apart) + 1
        of = self._values[filled]
        values = (self._low[filled], self._high[filled], self._sum[filled] / of)
        times = np.insert(self._steps.middles[filled], breaks, self._steps.middles[filled[breaks]])
        low, high, mean = (np.insert(v, breaks, np.nan) for v in values)
        return times, low, high, mean


class Presence:
    """In which steps there was something of a kind, be it only once."""

    def __init__(self, steps: Steps, kinds: tuple[str, ...]) -> None:
        self._steps = steps
        self.kinds = {kind: np.zeros(steps.count, np.bool_) for kind in kinds}

    def add(self, kind: str, step: int, last: int | None = None) -> None:
        """Note a kind in a step, or from it to the last."""
        if kind in self.kinds:
            self.kinds[kind][step : (step if last is None else last) + 1] = True

    def spans(self, kind: str) -> list[tuple[float, float]]:
        """Begin and length of the times with that kind, in days since 1970."""
        edges = np.flatnonzero(np.diff(np.concatenate(([False], self.kinds[kind], [False])).astype(np.int8)))
        began, width = days(self._steps.began_ns), days(self._steps.width_ns)
        return [(began + a * width, (b - a) * width) for a, b in edges.reshape(-1, 2).tolist()]
