"""Tell open tubes, plugs and bare plate apart, by what the open tubes nearby look like."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_of
from service.vision.measurement import TubeState

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.rims import Rims
    from service.vision.sites import Sites

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["tube_states"]

NEARBY = 3.0
"""How far, in rows and columns, the open tubes may stand that a place is compared with."""
LEAST_NEARBY = 3
FAINT = 0.5
"""A rim measured with less than this part of the usual edge may be a plug's: its bore is looked at."""
BRIGHT = 0.5
"""A bore brighter than its neighbours' by this share of their edges' height is not open."""
DARK = 0.3
RELIEF = 0.22
"""A plug shows its rim, bare plate does not: height of the mean profile over the neighbours' edges."""


def tube_states(sites: Sites, rims: Rims, used: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """State of each place, (n,) uint8 of `TubeState`; UNKNOWN where it is too dark or covered to tell."""
    state = np.where(used, TubeState.OPEN, TubeState.UNKNOWN).astype(np.uint8)
    if not used.any():
        return state
    faint = used & (rims.gain < FAINT * median_of(rims.gain[used]))
    rest = np.flatnonzero((~used | faint) & (rims.rays > 0))
    if not len(rest):
        return state
    gain, bore = np.empty(len(rest)), np.empty(len(rest))
    _neighbours(sites.row, sites.column, used, rims.gain.copy(), rims.bore.copy(), rest, gain, bore)
    mean = rims.mean[rest]
    height = np.where(gain > 0, gain, np.inf)
    inside = (rims.bore[rest] - bore) / height
    step = (rims.outside[rest] - rims.bore[rest]) / height
    relief = (mean.max(axis=1) - mean.min(axis=1)) / height
    told, shows_rim = gain > 0, faint[rest] | (relief >= RELIEF)
    state[rest[told & (inside < DARK) & (step > BRIGHT * DARK)]] = TubeState.OPEN
    state[rest[told & (inside > BRIGHT) & shows_rim]] = TubeState.PLUGGED
    state[rest[told & (inside > BRIGHT) & ~shows_rim]] = TubeState.ABSENT
    return state


@compiled
def _neighbours(
    row: NDArray[np.int64], column: NDArray[np.int64], used: NDArray[np.bool_], gain: Array, bore: Array,
    which: NDArray[np.int64], near_gain: Array, near_bore: Array,
) -> None:  # fmt: skip
    """Mean edge height and bore level of the open tubes about each place; a negative height where there are too few."""
    for j in range(which.shape[0]):
        i, n, g, b = which[j], 0, 0.0, 0.0
        for k in range(row.shape[0]):
            if used[k] and abs(row[k] - row[i]) <= NEARBY and abs(column[k] - column[i]) <= NEARBY:
                g += gain[k]
                b += bore[k]
                n += 1
        near_gain[j] = g / n if n >= LEAST_NEARBY else -1.0
        near_bore[j] = b / n if n >= LEAST_NEARBY else 0.0
