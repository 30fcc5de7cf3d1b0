"""Find rims whose edges may lie far from where they are expected, ray by ray: the first passes about a rough pose."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_in_place
from service.vision.rays import BASIS
from service.vision.rim_levels import COVERED, HEIGHT, INNER_LEVEL, RADIUS, STRENGTH

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]
    Single: TypeAlias = NDArray[np.float32]

__all__ = ["REACH", "find"]

REACH = 1.6
"""Largest shift of a ray, in edge widths, that the linear model serves."""

LEAST_RAY_GAIN = 0.12
"""A ray whose gain falls below this share of the tube's shows no edge."""
LEAST_RAY_SIGMA = 0.05
"""A ray is never better than this, px: the template is not exact."""
SHARED = 1.4
"""Neighbouring rays see the same pixels: their common error counts once, measured on truth."""
LEAST_AGREEING = 6.0
FOUND = 7


@compiled
def find(
    numbers: Single, direction: Single, valid: Single, first: Array, edge: Array, moved: Array, reach: float,
    told: Array,
) -> None:  # fmt: skip
    """Shift, radius and covariance of each tube whose edge may lie up to `reach` px off, into `told`.

    `told` is that of `rim_levels.levels`, which have been found.
    """
    count = valid.shape[0]
    of_one, shift_of_one = 0.0, 0.0
    for p in range(BASIS):
        of_one += edge[p] * first[p]
        shift_of_one += moved[p] * first[p]
    work, shift, weight, out = np.empty(count), np.empty(count), np.empty(count), np.empty(FOUND)
    normal = np.empty((count, 2))
    for i in range(valid.shape[1]):
        gain, bore = told[HEIGHT, i], told[INNER_LEVEL, i]
        if gain <= 0.0 or told[COVERED, i] == 0.0:
            continue
        for k in range(count):  # brighter rays count more, up to a limit
            normal[k, 0], normal[k, 1] = direction[0, k, i], direction[1, k, i]
            weight[k] = 0.0
            if valid[k, i] == 0.0:
                continue
            g, gs = -bore * of_one, -bore * shift_of_one
            for p in range(BASIS):
                g += edge[p] * numbers[p, k, i]
                gs += moved[p] * numbers[p, k, i]
            if g > LEAST_RAY_GAIN * gain and abs(gs) < reach * g:
                shift[k] = gs / g
                weight[k] = min(g / gain, 1.5) ** 2
        if _circle_fit(normal, shift, weight, work, out):
            for p in range(5):
                told[p, i] = out[p]
            told[COVERED, i], told[RADIUS, i] = out[5], out[6]
        else:
            told[STRENGTH, i] = -1.0


@compiled
def _circle_fit(normal: Array, shift: Array, weight: Array, work: Array, out: Array) -> bool:
    """Solve ``shift = n . (dx, dy) + dr`` by Tukey's biweight; False where too few rays agree on it.

    `out` takes dx, dy, their covariance xx, xy, yy, the share of the rays that agree, and dr.
    """
    count = shift.shape[0]
    x, cov = np.zeros(3), np.zeros(3)
    scale, variance, used = 1e9, 0.0, 0.0
    for step in range(3):
        a00, a01, a02, a11, a12, a22, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        used = 0.0
        inverse_cut = 1.0 / (4.685 * scale) ** 2
        for k in range(count):
            w = weight[k]
            if w <= 0.0:
                continue
            nx, ny = normal[k, 0], normal[k, 1]
            r = shift[k] - nx * x[0] - ny * x[1] - x[2]
            u = 1.0 - r * r * w * inverse_cut
            if u <= 0.0:
                continue
            w *= u * u
            used += u
            a00 += w * nx * nx
            a01 += w * nx * ny
            a02 += w * nx
            a11 += w * ny * ny
            a12 += w * ny
            a22 += w
            b0 += w * nx * shift[k]
            b1 += w * ny * shift[k]
            b2 += w * shift[k]
        if used < LEAST_AGREEING:
            return False
        det = a00 * (a11 * a22 - a12 * a12) - a01 * (a01 * a22 - a12 * a02) + a02 * (a01 * a12 - a11 * a02)
        if det < 1e-5 * a22 * a22 * a22:
            return False
        i00, i01, i02 = (a11 * a22 - a12 * a12) / det, (a02 * a12 - a01 * a22) / det, (a01 * a12 - a02 * a11) / det
        i11, i12, i22 = (a00 * a22 - a02 * a02) / det, (a01 * a02 - a00 * a12) / det, (a00 * a11 - a01 * a01) / det
        x[0], x[1], x[2] = (
            i00 * b0 + i01 * b1 + i02 * b2,
            i01 * b0 + i11 * b1 + i12 * b2,
            i02 * b0 + i12 * b1 + i22 * b2,
        )
        cov[0], cov[1], cov[2] = i00, i01, i11
        if step == 2:
            break
        c = 0
        for k in range(count):
            if weight[k] > 0.0:
                r = shift[k] - normal[k, 0] * x[0] - normal[k, 1] * x[1] - x[2]
                work[c] = r * r * weight[k]
                c += 1
        scale = 1.4826 * math.sqrt(median_in_place(work, c)) + 0.02
        variance = max(scale, LEAST_RAY_SIGMA) ** 2
    out[0], out[1], out[5], out[6] = x[0], x[1], used / count, x[2]
    for p in range(3):
        out[2 + p] = cov[p] * variance * SHARED * SHARED
    return True
