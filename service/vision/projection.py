"""Sheet to picture and back, compiled. Intrinsics `v` are `camera.lens_vector`'s array."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.camera import TSAI
from service.vision.compiled import compiled, median_in_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]

__all__ = [
    "distort_jacobian", "distort_point", "project", "project_point", "scale_of", "undistort", "undistort_point",
]  # fmt: skip

NEWTON_STEP = 1e-7
"""Relative step after which a root stands: each step squares the error."""


@compiled
def distort_point(v: Array, x: float, y: float) -> tuple[float, float]:
    """Distorted from undistorted normalised coordinates; NaN where the lens model folds back."""
    r2 = x * x + y * y
    if not r2 < v[10]:
        return math.nan, math.nan
    if v[4] == TSAI:
        k = v[5]
        if k == 0.0 or r2 == 0.0:
            return x, y
        r = math.sqrt(r2)
        # Newton on d (1 + k d^2) = r: for k > 0 from anywhere, else from inside the fold, where the cubic is monotone
        bend = k * r2
        d = r * (1.0 - bend * (1.0 - 3.0 * bend)) if abs(bend) < 0.15 else r / (1.0 + bend) if bend > 0.0 else r
        for _ in range(50):
            slope = 1.0 + 3.0 * k * d * d
            if slope < 1e-9:
                d *= 0.999
                continue
            step = (d * (1.0 + k * d * d) - r) / slope
            d -= step
            if abs(step) < NEWTON_STEP * d:
                break
        return x * d / r, y * d / r
    s = 1.0 + r2 * (v[5] + r2 * (v[6] + r2 * v[9]))
    return x * s + 2.0 * v[7] * x * y + v[8] * (r2 + 2.0 * x * x), y * s + v[7] * (r2 + 2.0 * y * y) + 2.0 * v[
        8
    ] * x * y


@compiled
def distort_jacobian(v: Array, x: float, y: float, xd: float, yd: float) -> tuple[float, float, float, float]:
    """d(distorted)/d(undistorted) at undistorted (x, y), whose distorted image is (xd, yd): xx, xy, yx, yy."""
    if v[4] == TSAI:
        k = v[5]
        s = 1.0 + k * (xd * xd + yd * yd)
        a, b, d = s + 2.0 * k * xd * xd, 2.0 * k * xd * yd, s + 2.0 * k * yd * yd
        det = a * d - b * b
        return d / det, -b / det, -b / det, a / det
    r2 = x * x + y * y
    s = 1.0 + r2 * (v[5] + r2 * (v[6] + r2 * v[9]))
    g = 2.0 * (v[5] + r2 * (2.0 * v[6] + 3.0 * r2 * v[9]))
    cross = g * x * y + 2.0 * (v[7] * x + v[8] * y)
    return (
        s + g * x * x + 2.0 * v[7] * y + 6.0 * v[8] * x,
        cross,
        cross,
        s + g * y * y + 6.0 * v[7] * y + 2.0 * v[8] * x,
    )


@compiled
def undistort_point(v: Array, xd: float, yd: float) -> tuple[float, float]:
    """Undistorted from distorted normalised coordinates; NaN where no undistorted point has that image."""
    if v[4] == TSAI:
        r2 = xd * xd + yd * yd
        if v[5] < 0.0 and 3.0 * v[5] * r2 <= -1.0:
            return math.nan, math.nan
        s = 1.0 + v[5] * r2
        return xd * s, yd * s
    x, y = xd, yd
    for _ in range(40):
        u, w = distort_point(v, x, y)
        if math.isnan(u):  # beyond the fold: come back inside
            x, y = 0.7 * x, 0.7 * y
            continue
        a, b, c, d = distort_jacobian(v, x, y, u, w)
        det = a * d - b * c
        ex, ey = xd - u, yd - w
        sx, sy = (d * ex - b * ey) / det, (a * ey - c * ex) / det
        x, y = x + sx, y + sy
        if sx * sx + sy * sy < 1e-28:
            return x, y
    u, w = distort_point(v, x, y)
    if abs(u - xd) + abs(w - yd) < 1e-9:
        return x, y
    return math.nan, math.nan


@compiled
def project_point(v: Array, R: Array, t: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Picture point (px) of a sheet point (mm); NaN behind the camera or where the lens model folds back."""
    xc = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
    yc = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
    zc = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
    if not zc > 0.0:
        return math.nan, math.nan
    xd, yd = distort_point(v, xc / zc, yc / zc)
    return v[2] + v[0] * xd, v[3] + v[1] * yd


@compiled
def project(v: Array, R: Array, t: Array, sheet_mm: Array) -> Array:
    """Picture points, (n, 2) px, of sheet points, (n, 2) mm at Z = 0 or (n, 3); NaN rows where there is none."""
    n = sheet_mm.shape[0]
    out = np.empty((n, 2))
    for i in range(n):
        z = sheet_mm[i, 2] if sheet_mm.shape[1] == 3 else 0.0
        out[i, 0], out[i, 1] = project_point(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], z)
    return out


@compiled
def undistort(v: Array, points_px: Array) -> Array:
    """Undistorted normalised coordinates, (n, 2), of picture points, (n, 2) px; NaN rows where there are none."""
    out = np.empty_like(points_px)
    for i in range(points_px.shape[0]):
        out[i, 0], out[i, 1] = undistort_point(v, (points_px[i, 0] - v[2]) / v[0], (points_px[i, 1] - v[3]) / v[1])
    return out


@compiled
def scale_of(place: Array) -> float:
    """Scale of a picture, px per mm, in the middle of all places, whose derivatives are (n, 2, 3), n >= 1."""
    n = place.shape[0]
    scale = np.empty(n)
    for i in range(n):
        scale[i] = math.sqrt(place[i, 0, 0] * place[i, 0, 0] + place[i, 0, 1] * place[i, 0, 1])
    return median_in_place(scale, n)
