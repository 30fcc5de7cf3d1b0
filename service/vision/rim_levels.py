"""What the rays of each tube tell before its rim is solved for: levels, height of the edge, noise."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_of, sort_columns
from service.vision.rays import BASIS, BORE, NOISE, OUTSIDE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]
    Single: TypeAlias = NDArray[np.float32]

__all__ = [
    "COVARIANCE",
    "COVERED",
    "FIGURES",
    "HEIGHT",
    "INNER_LEVEL",
    "OUTER_LEVEL",
    "RADIUS",
    "SHIFT",
    "STRENGTH",
    "levels",
]  # fmt: skip

SHIFT, COVARIANCE, HEIGHT, INNER_LEVEL, OUTER_LEVEL, STRENGTH, COVERED, RADIUS, FIGURES = 0, 2, 5, 6, 7, 8, 9, 10, 11
"""Rows of what is told of tubes, (FIGURES, n): shift x, y; its covariance xx, xy, yy; height of the edge; levels in the
bore and outside, above that of the rays; strength; share of the rays that take part; radius; lengths in px of x."""
LEAST_RAYS = 8
"""Fewer rays in the picture tell nothing of a tube."""
FIRST_LIMIT, LIMIT = np.float32(3.0), np.float32(2.5)
"""Mean deviations beyond which a ray does not count for a mean."""
ONE, NOTHING, LEAST_REACH = np.float32(1.0), np.float32(0.0), np.float32(1e-9)


@compiled
def levels(numbers: Single, valid: Single, first: Array, edge: Array, told: Array) -> float:
    """Levels, height of the edge and strength of each tube, into `told`; gives the noise of a grey value.

    Means rather than medians: no branch depends on the data, and many tubes are served at a time.
    """
    count, n = valid.shape
    rays, work, mean, stray = np.zeros(n), np.empty((count, n), np.float32), np.empty(n), np.empty(n)
    for k in range(count):
        for i in range(n):
            rays[i] += valid[k, i]
    for which, row in ((BORE, INNER_LEVEL), (OUTSIDE, OUTER_LEVEL)):
        _clipped_means(numbers[which], valid, mean, stray)
        told[row] = mean
    _heights(numbers, first, edge, told[INNER_LEVEL], work)
    _clipped_means(work, valid, mean, stray)
    for i in range(n):
        told[HEIGHT, i] = mean[i]
        told[STRENGTH, i] = mean[i] * math.sqrt(rays[i]) / (1.25 * stray[i] + 1e-6)
        told[COVERED, i] = rays[i] / count
        if rays[i] < LEAST_RAYS:
            told[HEIGHT, i], told[STRENGTH, i], told[COVERED, i] = 0.0, -1.0, 0.0
    for k in range(count):
        for i in range(n):
            work[k, i] = abs(numbers[NOISE, k, i]) if valid[k, i] > NOTHING else np.float32(np.inf)
    sort_columns(work)
    noises, m = np.empty(n), 0
    for i in range(n):
        if rays[i] >= LEAST_RAYS:
            noises[m] = work[int(rays[i]) // 2, i]
            m += 1
    return 1.4826 / math.sqrt(6.0) * median_of(noises[:m]) + 0.3 if m else 1.0


@compiled
def _heights(numbers: Single, first: Array, edge: Array, bore: Array, height: Single) -> None:
    """Height of each ray's edge above its tube's bore, by itself."""
    of_one = 0.0
    for p in range(BASIS):
        of_one += edge[p] * first[p]
    e0, e1, e2, e3, e4 = (
        np.float32(edge[0]), np.float32(edge[1]), np.float32(edge[2]), np.float32(edge[3]), np.float32(edge[4])
    )  # fmt: skip
    below = (bore * of_one).astype(np.float32)
    for k in range(height.shape[0]):
        for i in range(height.shape[1]):
            height[k, i] = (
                e0 * numbers[0, k, i] + e1 * numbers[1, k, i] + e2 * numbers[2, k, i] + e3 * numbers[3, k, i]
                + e4 * numbers[4, k, i] - below[i]
            )  # fmt: skip


@compiled
def _clipped_means(a: Single, valid: Single, mean: Array, stray: Array) -> None:
    """Mean of each tube's rays without those that stray by more than LIMIT times the mean deviation; that as well."""
    count, n = a.shape
    rays, middle, spread = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    for k in range(count):
        for i in range(n):
            rays[i] += valid[k, i]
            middle[i] += valid[k, i] * a[k, i]
    for i in range(n):
        rays[i] = max(rays[i], ONE)
        middle[i] /= rays[i]
    total, counted = np.empty(n, np.float32), np.empty(n, np.float32)
    for limit in (FIRST_LIMIT, LIMIT):
        _spreads(a, valid, middle, rays, spread)
        for i in range(n):
            total[i], counted[i], spread[i] = NOTHING, NOTHING, limit * spread[i] + LEAST_REACH
        for k in range(count):
            for i in range(n):
                counts = valid[k, i] if abs(a[k, i] - middle[i]) <= spread[i] else NOTHING
                counted[i] += counts
                total[i] += counts * a[k, i]
        for i in range(n):
            middle[i] = total[i] / max(counted[i], ONE)
    _spreads(a, valid, middle, rays, spread)
    for i in range(n):
        mean[i], stray[i] = middle[i], spread[i]


@compiled
def _spreads(a: Single, valid: Single, middle: Single, rays: Single, spread: Single) -> None:
    """Mean deviation of each tube's rays from its middle."""
    for i in range(a.shape[1]):
        spread[i] = NOTHING
    for k in range(a.shape[0]):
        for i in range(a.shape[1]):
            spread[i] += valid[k, i] * abs(a[k, i] - middle[i])
    for i in range(a.shape[1]):
        spread[i] /= rays[i]
