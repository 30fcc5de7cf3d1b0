"""Times that can be compared: everything takes its turns in the same minutes on the same machine."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class Times:
    """What each call took, ms, and what it gave."""

    ms: list[float] = field(default_factory=list)
    results: list[tuple[int, Any]] = field(default_factory=list)

    @property
    def median(self) -> float:
        return float(np.median(self.ms))

    @property
    def p99(self) -> float:
        """By nearest rank: the longest where there are fewer than a hundred."""
        return float(np.percentile(self.ms, 99, method="higher"))


def interleaved(
    calls: dict[str, Callable[[int], Any]], numbers: Iterable[int], *, rounds: int, budget_s: float, skip: int = 2
) -> dict[str, Times]:
    """Let each call have its turn, round by round, until its time is used up.

    Parameters
    ----------
    calls
        Each takes the number of a picture.
    numbers
        Of the pictures, one a round.
    skip
        First calls of each that count for nothing.
    """
    times = {name: Times() for name in calls}
    spent = dict.fromkeys(calls, 0.0)
    for turn, number in zip(range(rounds + skip), numbers, strict=False):
        for name, call in calls.items():
            if spent[name] > budget_s and turn > skip + 1:
                continue
            began = time.perf_counter_ns()
            result = call(number)
            took = time.perf_counter_ns() - began
            spent[name] += took / 1e9
            if turn >= skip:
                times[name].ms.append(took / 1e6)
                times[name].results.append((number, result))
    return times
