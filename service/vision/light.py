"""How the light falls off over a tube end, as its neighbours tell it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["SLOPE_REACH", "light_slopes"]

SLOPE_REACH = 2.3
"""How far, in pitches, neighbours tell how the light falls off."""
MOST_NEARBY = 64
"""Three times as many as a lattice has within that reach."""
SLOPE_STRENGTH = 4.0
SLOPE_PRIOR = 0.3
"""Information, in tubes at the edge of that reach, that draws the light towards level."""
SLOPE_STRAY = 0.8
"""A tube whose edge differs by this, as a logarithm, is stained and does not tell."""


@compiled
def light_slopes(
    center: Array, aspect: float, gain: Array, strength: Array, reach: float, radius: float, slope: Array
) -> None:
    """How the light changes from each tube's centre to its rim: slope of the logarithm of its neighbours' gains.

    A plane through the neighbours, drawn towards level light; one reweighting sets stained tubes aside. Tubes are
    looked up in square cells as wide as the reach.
    """
    n = center.shape[0]
    tells = np.empty(n, np.bool_)
    log = np.empty(n)
    right, bottom = 0.0, 0.0
    for i in range(n):
        tells[i] = strength[i] >= SLOPE_STRENGTH and center[i, 0] > -reach and center[i, 1] > -reach
        if tells[i]:
            log[i] = math.log(gain[i])
            right, bottom = max(right, center[i, 0]), max(bottom, center[i, 1] * aspect)
    across, down, near = int(right / reach) + 4, int(bottom / reach) + 4, np.empty((4, MOST_NEARBY))
    first, next_one = np.full(across * down, -1, np.int64), np.empty(n, np.int64)
    for i in range(n):
        if tells[i]:
            cell = (int(center[i, 1] * aspect / reach + 1.0) + 1) * across + int(center[i, 0] / reach + 1.0) + 1
            next_one[i] = first[cell]
            first[cell] = i
    for i in range(n):
        if not tells[i]:
            continue
        x0, y0 = center[i, 0], center[i, 1] * aspect
        cx, cy = int(x0 / reach + 1.0) + 1, int(y0 / reach + 1.0) + 1
        m = 0
        for row in range(max(cy - 1, 0), min(cy + 2, down)):
            for col in range(max(cx - 1, 0), min(cx + 2, across)):
                j = first[row * across + col]
                while j >= 0:
                    dx, dy = (center[j, 0] - x0) / reach, (center[j, 1] * aspect - y0) / reach
                    d2 = dx * dx + dy * dy
                    if d2 < 1.0 and m < MOST_NEARBY:
                        near[0, m], near[1, m], near[2, m], near[3, m] = dx, dy, log[j], 1.0 - d2
                        m += 1
                    j = next_one[j]
        a, bx, by = log[i], 0.0, 0.0
        for step in range(2):
            s0, sx, sy, sxx, sxy, syy, t0, tx, ty = 0.0, 0.0, 0.0, SLOPE_PRIOR, 0.0, SLOPE_PRIOR, 0.0, 0.0, 0.0
            for k in range(m):
                dx, dy, z = near[0, k], near[1, k], near[2, k]
                r = (z - a - bx * dx - by * dy) / SLOPE_STRAY if step else 0.0
                w = (near[3, k] * max(1.0 - r * r, 0.0)) ** 2
                s0 += w
                sx += w * dx
                sy += w * dy
                sxx += w * dx * dx
                sxy += w * dx * dy
                syy += w * dy * dy
                t0 += w * z
                tx += w * z * dx
                ty += w * z * dy
            if s0 < 2.0:
                bx, by = 0.0, 0.0
                break
            vxx, vxy, vyy = sxx - sx * sx / s0, sxy - sx * sy / s0, syy - sy * sy / s0
            ux, uy = tx - sx * t0 / s0, ty - sy * t0 / s0
            det = vxx * vyy - vxy * vxy
            bx, by = (vyy * ux - vxy * uy) / det, (vxx * uy - vxy * ux) / det
            a = (t0 - bx * sx - by * sy) / s0
        slope[i, 0], slope[i, 1] = bx * radius / reach, by * radius / reach
