"""How the light falls off over a tube end, as all tubes together tell it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.cholesky import solved
from service.vision.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["light_slopes"]

TERMS = 6
LEAST_TELLING = 6
TELLING_STRENGTH = 4.0
STRAY = 0.8
"""A tube whose edge differs by this from the others', as a logarithm, is stained or in a shadow and does not tell."""
ROUNDS = 3
LEVEL, EVEN = 0.01, 0.05
"""Information, in tubes at the picture's edge, that draws slopes and curvature of the light towards nothing."""


@compiled
def light_slopes(center: Array, aspect: float, gain: Array, strength: Array, radius: float, slope: Array) -> None:
    """How the light changes from each tube's centre to its rim, as a part of itself, into `slope`, (2, n).

    The logarithm of the edges' heights is taken for a polynomial of second order over the picture: a lamp's spot is
    one. Its slope is known even where tubes are too dim to tell it themselves. Lengths are in px of x.
    """
    n = center.shape[0]
    tells = np.empty(n, np.bool_)
    low, high, known = np.full(2, math.inf), np.full(2, -math.inf), 0
    for i in range(n):
        tells[i] = strength[i] >= TELLING_STRENGTH and gain[i] > 0.0 and not math.isnan(center[i, 0])
        if tells[i]:
            known += 1
            for k in range(2):
                low[k], high[k] = min(low[k], center[i, k]), max(high[k], center[i, k])
    if known < LEAST_TELLING:
        return
    half = max(0.5 * max(high[0] - low[0], aspect * (high[1] - low[1])), radius)
    x0, y0 = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])
    place, log = np.empty((2, n)), np.empty(n)
    for i in range(n):
        place[0, i], place[1, i] = (center[i, 0] - x0) / half, aspect * (center[i, 1] - y0) / half
        log[i] = math.log(gain[i]) if tells[i] else 0.0
    c = _trend(place, tells, log)
    for i in range(n):
        x, y = place[0, i], place[1, i]
        if not math.isnan(x):
            slope[0, i] = (c[1] + 2.0 * c[3] * x + c[4] * y) * radius / half
            slope[1, i] = (c[2] + c[4] * x + 2.0 * c[5] * y) * radius / half


@compiled
def _trend(place: Array, tells: NDArray[np.bool_], log: Array) -> Array:
    """Polynomial, (TERMS,) of 1, x, y, xx, xy, yy, through what tubes tell; robust."""
    c, f = np.zeros(TERMS), np.empty(TERMS)
    for step in range(ROUNDS):
        A, b = np.zeros((TERMS, TERMS)), np.zeros(TERMS)
        for i in range(log.shape[0]):
            if not tells[i]:
                continue
            x, y = place[0, i], place[1, i]
            f[0], f[1], f[2], f[3], f[4], f[5] = 1.0, x, y, x * x, x * y, y * y
            r = 0.0
            if step:
                r = log[i]
                for p in range(TERMS):
                    r -= c[p] * f[p]
            w = max(1.0 - (r / STRAY) ** 2, 0.0) ** 2
            for p in range(TERMS):
                b[p] += w * f[p] * log[i]
                for q in range(p + 1):
                    A[p, q] += w * f[p] * f[q]
        for p in range(1, TERMS):
            A[p, p] += LEVEL if p < 3 else EVEN
        A[0, 0] += 1e-6
        c = solved(A, b)
    return c
