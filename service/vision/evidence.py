"""Tell a lattice index from its neighbours': a slip by a pitch leaves every residual of the pose unchanged.

What shows it is what tells places apart: plugs, absent tubes, and that every real tube end stands a little off its
nominal place, always by the same. A map of both is kept while the index is trusted; where it is in doubt, the picture
is compared with the map under every shift that may have happened.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled
from service.vision.measurement import TubeState

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice
    from service.vision.refinement import Refined

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["CONTRADICTION", "SUSPICIOUS", "PlaceMap", "Verdict"]

REACH = 160
"""Rows and columns either way of the origin that the map holds: more than any tubesheet has."""
WINDOW = 8
"""Largest shift, in rows and columns, that is compared."""
DECISIVE = 20.0
"""By how much, in natural logarithms, the best shift must beat the second: one in 5e8, with room for what is shared."""
SUSPICIOUS, CONTRADICTION = -0.05, -0.1
"""A picture that fits the map so much worse than no map at all, in natural logarithms a tube, is compared with all
other places; and speaks against its index whatever they say. The right one gives 0 to 1, a wrong one -0.15 to -0.7."""
FEW = 100
"""Fewer tubes count as so many: chance does more among few."""
STATE_LOG_ODDS = 3.0
"""What one place of a known state that agrees, or disagrees, counts for."""
LEAST_COMMON = 12
"""Fewer places in common with the map do not decide."""
CHANGING = 0.65
"""Part of a centre's variance that differs from picture to picture; the rest is the tube's own way of looking."""
ASIDE = 0.04
"""By how much, in edge widths, a centre strays as the view changes: light, and lines that are wider than the edge."""
MOST_PICTURES = 30.0
"""A place's mean settles after so many pictures: what a pose's own error puts into them is shared by all."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the map says of a picture's index.

    Attributes
    ----------
    row, column
        The shift that fits best: the picture's place (r, c) is the map's (r + row, c + column).
    margin
        By how much it beats the second best, natural logarithm.
    fit
        By how much it beats a map that says nothing.
    """

    row: int
    column: int
    margin: float
    fit: float

    @property
    def slipped(self) -> bool:
        """Whether another place fits better."""
        return bool(self.row or self.column)

    @property
    def decisive(self) -> bool:
        """Whether the best shift is beyond doubt."""
        return self.margin > DECISIVE and (self.fit > 0.0 or not self.slipped)


class PlaceMap:
    """Where real tube ends stand off their nominal places, and what stands there."""

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        side = 2 * REACH + 1
        self._off = np.zeros((side, side, 2))
        self._weight = np.zeros((side, side))
        self._state = np.zeros((side, side, 4))

    def learn(self, refined: Refined) -> None:
        """Add a picture whose index is trusted."""
        off, variance = _offsets(refined)
        _learn(
            refined.sites.row, refined.sites.column, refined.used, off, variance, refined.state, self._off,
            self._weight, self._state,
        )  # fmt: skip

    def fit(self, refined: Refined) -> float:
        """How much better the map explains a picture than no map does, natural logarithm a tube."""
        score, common = self._scores(refined, 0)
        return float(score[0, 0] / max(common[0, 0], FEW))

    def compare(self, refined: Refined) -> Verdict | None:
        """Find the shift, up to `WINDOW`, that fits best; None where picture and map share too little."""
        score, common = (a.ravel() for a in self._scores(refined, WINDOW))
        best, second = np.argsort(-score, kind="stable")[:2]
        if common[best] < LEAST_COMMON:
            return None
        row, column = divmod(int(best), 2 * WINDOW + 1)
        return Verdict(row - WINDOW, column - WINDOW, float(score[best] - score[second]), float(score[best]))

    def _scores(self, refined: Refined, window: int) -> tuple[Array, NDArray[np.int64]]:
        """Log-likelihood ratio of every shift up to `window`, and the tubes it rests on."""
        off, variance = _offsets(refined)
        side = 2 * window + 1
        score, common = np.zeros((side, side)), np.zeros((side, side), np.int64)
        _compare(
            refined.sites.row, refined.sites.column, refined.used, off, variance, refined.state, self._off,
            self._weight, self._state, self._lattice.scatter_mm**2, score, common,
        )  # fmt: skip
        return score, common


def _offsets(refined: Refined) -> tuple[Array, Array]:
    """Each place's offset from nominal in the sheet, (n, 2) mm, and its variance, (n,) mm^2."""
    n = len(refined.sites)
    off, variance = np.empty((n, 2)), np.empty(n)
    _to_sheet(refined.place, refined.rims.center_px, refined.predicted_px, refined.rims.covariance_px, off, variance)
    return off, CHANGING * variance + (ASIDE * refined.common.profile.width_px / refined.scale) ** 2


@compiled
def _to_sheet(place: Array, center: Array, predicted: Array, covariance: Array, off: Array, variance: Array) -> None:
    for i in range(place.shape[0]):
        a, b, c, d = place[i, 0, 0], place[i, 0, 1], place[i, 1, 0], place[i, 1, 1]
        det = a * d - b * c
        dx, dy = center[i, 0] - predicted[i, 0], center[i, 1] - predicted[i, 1]
        off[i, 0], off[i, 1] = (d * dx - b * dy) / det, (a * dy - c * dx) / det
        variance[i] = 0.5 * (covariance[i, 0] + covariance[i, 2]) / abs(det)


@compiled
def _learn(
    row: NDArray[np.int64], column: NDArray[np.int64], used: NDArray[np.bool_], off: Array, variance: Array,
    state: NDArray[np.uint8], map_off: Array, map_weight: Array, map_state: Array,
) -> None:  # fmt: skip
    for i in range(row.shape[0]):
        r, c = row[i] + REACH, column[i] + REACH
        if not (0 <= r < map_off.shape[0] and 0 <= c < map_off.shape[1]):
            continue
        map_state[r, c, state[i]] = min(map_state[r, c, state[i]] + 1.0, MOST_PICTURES)
        if used[i]:
            w = 1.0 / variance[i]
            total = min(map_weight[r, c] + w, MOST_PICTURES * w)
            for k in range(2):
                map_off[r, c, k] += (off[i, k] - map_off[r, c, k]) * w / total
            map_weight[r, c] = total


@compiled
def _compare(
    row: NDArray[np.int64], column: NDArray[np.int64], used: NDArray[np.bool_], off: Array, variance: Array,
    state: NDArray[np.uint8], map_off: Array, map_weight: Array, map_state: Array, scatter2: float, score: Array,
    common: NDArray[np.int64],
) -> None:  # fmt: skip
    """Log-likelihood ratio of each shift against a map that says nothing."""
    window = score.shape[0] // 2
    for dr in range(score.shape[0]):
        for dc in range(score.shape[1]):
            for i in range(row.shape[0]):
                r, c = row[i] + REACH + dr - window, column[i] + REACH + dc - window
                if not (0 <= r < map_off.shape[0] and 0 <= c < map_off.shape[1]):
                    continue
                known = map_state[r, c]
                seen = known[TubeState.OPEN] + known[TubeState.PLUGGED] + known[TubeState.ABSENT]
                if seen < 1.0:
                    continue
                if state[i] != TubeState.UNKNOWN:
                    share = known[state[i]] / seen
                    odd = state[i] != TubeState.OPEN or known[TubeState.OPEN] < 0.5 * seen
                    score[dr, dc] += STATE_LOG_ODDS * (2.0 * share - 1.0) if odd else 0.0
                if used[i] and map_weight[r, c] > 0.0:
                    common[dr, dc] += 1
                    v0 = variance[i] + scatter2
                    gain = scatter2 / (scatter2 + 1.0 / map_weight[r, c])
                    v1 = variance[i] + scatter2 * (1.0 - gain)
                    for k in range(2):
                        d = off[i, k] - gain * map_off[r, c, k]
                        score[dr, dc] += 0.5 * (off[i, k] ** 2 / v0 - d * d / v1 + math.log(v0 / v1))
