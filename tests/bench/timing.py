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
    calls: dict[str, Callable[[Any], Any]], numbers: Iterable[int], *, rounds: int, budget_s: float, skip: int = 2,
    handed: Callable[[str, int], Any] | None = None,
) -> dict[str, Times]:  # fmt: skip
    """Let each call have its turn, round by round, until its time is used up.

    Parameters
    ----------
    calls
        Each takes the number of a picture.
    numbers
        Of the pictures, one a round.
    skip
        First calls of each that count for nothing.
    handed
        What a call is handed in place of a picture's number; the time that this takes is not the call's.
    """
    times = {name: Times() for name in calls}
    spent = dict.fromkeys(calls, 0.0)
    for turn, number in zip(range(rounds + skip), numbers, strict=False):
        for name, call in calls.items():
            if spent[name] > budget_s and turn > skip + 1:
                continue
            given = number if handed is None else handed(name, number)
            began = time.perf_counter_ns()
            result = call(given)
            took = time.perf_counter_ns() - began
            spent[name] += took / 1e9
            if turn >= skip:
                times[name].ms.append(took / 1e6)
                times[name].results.append((number, result))
    return times
