"""Tell open tubes, plugs and bare plate apart, by what the open tubes nearby look like."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_in_place
from service.vision.measurement import TubeState

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.rims import Rims
    from service.vision.sites import Sites

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["tube_states"]

UNKNOWN, OPEN, PLUGGED, ABSENT = (np.uint8(s) for s in TubeState)

NEARBY = 3.0
"""How far, in rows and columns, the open tubes may stand that a place is compared with."""
LEAST_NEARBY = 3
FAINT = 0.5
"""A rim measured with less than this part of the usual edge may be a plug's: its bore is looked at."""
BRIGHT = 0.42
"""A bore brighter than its neighbours' by this share of their edges' height is not open."""
DARK = 0.24
RELIEF = 0.25
"""A plug shows its rim, bare plate does not: height of the mean profile over the neighbours' edges."""


def tube_states(sites: Sites, rims: Rims, used: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """State of each place, (n,) uint8 of `TubeState`; UNKNOWN where it is too dark or covered to tell."""
    state = np.empty(len(used), np.uint8)
    _tell(sites.row, sites.column, used, rims.rays, rims.gain, rims.bore, rims.outside, rims.mean, state)
    return state


@compiled
def _tell(
    row: NDArray[np.int64], column: NDArray[np.int64], used: NDArray[np.bool_], rays: Array, gain: Array, bore: Array,
    outside: Array, mean: Array, state: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Used places are open; those that are not used, or whose edge is faint, are held beside the open tubes nearby."""
    height_of, n = np.empty(row.shape[0]), 0
    for i in range(row.shape[0]):
        state[i] = OPEN if used[i] else UNKNOWN
        if used[i]:
            height_of[n] = gain[i]
            n += 1
    faint = FAINT * median_in_place(height_of, n) if n else 0.0
    for i in range(row.shape[0]):
        if rays[i] <= 0.0 or (used[i] and gain[i] >= faint):
            continue
        n, height, dark = 0, 0.0, 0.0
        for k in range(row.shape[0]):
            if used[k] and abs(row[k] - row[i]) <= NEARBY and abs(column[k] - column[i]) <= NEARBY:
                height += gain[k]
                dark += bore[k]
                n += 1
        if n < LEAST_NEARBY or height <= 0.0:
            continue
        height, dark = height / n, dark / n
        inside, step = (bore[i] - dark) / height, (outside[i] - bore[i]) / height
        if inside < DARK and step > BRIGHT * DARK:
            state[i] = OPEN
        elif inside > BRIGHT:
            state[i] = PLUGGED if np.ptp(mean[i]) / height >= RELIEF else ABSENT
