"""Sample a picture along the normals of projected circles, and condense what each ray shows."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled
from service.vision.edges import INNER, OUTER, SAMPLES
from service.vision.projection import project_point

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["BASIS", "BORE", "ENERGY", "NOISE", "NUMBERS", "OUTSIDE", "circle_of", "rays_for", "sample_rays"]

NODES = 8
"""Points of a circle that are projected exactly; a trigonometric polynomial through them gives the others."""
_ANGLE = 2 * np.pi * np.arange(NODES) / NODES
NODE_WAVES = np.column_stack([np.ones(NODES), np.cos(_ANGLE), np.sin(_ANGLE), np.cos(2 * _ANGLE), np.sin(2 * _ANGLE)])
RAY_SPACING_PX, FEWEST_RAYS, MOST_RAYS = 2.8, 16, 24
"""Rays stand this far apart on the rim, as neighbours would see the same pixels; more of them gain little."""
BASIS = 5
"""Shapes that a ray's grey values are made of, see `shapes`."""
ENERGY, BORE, OUTSIDE, NOISE, NUMBERS = 5, 6, 7, 8, 9
"""What a ray is condensed to: its samples with each shape; with themselves; levels inside and outside; a second
difference in the bore, which only noise makes."""


@lru_cache(maxsize=64)
def circle_of(count: int) -> Array:
    """Cosine and sine of `count` angles around a circle, and of twice those, (4, count)."""
    a = 2 * np.pi * np.arange(count) / count
    return np.array([np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)])


def rays_for(circumference_px: float) -> int:
    """How many rays a rim deserves; a multiple of four, so that few sizes occur."""
    return min(max(4 * round(circumference_px / RAY_SPACING_PX / 4), FEWEST_RAYS), MOST_RAYS)


@compiled
def sample_rays(
    image: Image, v: Array, R: Array, t: Array, sheet_mm: Array, radius_mm: float, circle: Array, offsets: Array,
    functionals: NDArray[np.float32], numbers: NDArray[np.float32], direction: NDArray[np.float32], center: Array,
    valid: NDArray[np.bool_], mean: Array, level: Array,
) -> None:  # fmt: skip
    """Sample along the normals of projected circles, bilinear; a ray that leaves the picture is not valid.

    Parameters
    ----------
    v, R, t
        Intrinsics and pose.
    sheet_mm, radius_mm, circle
        (n, 2) middles of the circles, and their points, `circle_of`.
    offsets
        (SAMPLES,) px of x along the normal, outwards.
    functionals
        (BASIS + 1, SAMPLES) float32: what samples are multiplied with; the last row weighs their squares.
    numbers, direction, center, valid, mean, level
        Filled in: (n, rays, NUMBERS) of grey values above `level`, (n, rays, 2) outward normals, of unit length where
        pixels are square, (n, 2) projected middles, (n, rays), (n, SAMPLES) mean over the rays, and (n,).
    """
    h, w = image.shape
    count, last = circle.shape[1], offsets.shape[0] - 1
    aspect = v[0] / v[1]
    wave, ray = np.empty((2, 5)), np.empty((4, count))
    scratch, place, u = np.empty((6, SAMPLES), np.float32), np.empty(SAMPLES, np.int32), offsets.astype(np.float32)
    grey, total = np.empty(SAMPLES, np.float32), np.empty(SAMPLES, np.float32)
    for i in range(sheet_mm.shape[0]):
        center[i, 0], center[i, 1] = project_point(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], 0.0)
        sense = _project_circle(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], radius_mm, wave)
        if math.isnan(center[i, 0]) or sense == 0.0:
            valid[i] = False
            continue
        seen = 0
        total[:] = 0.0
        _directions(wave, circle, sense, aspect, ray)
        base = np.float32(0.0)
        for k in range(count):
            x, y, nx, ny = ray[0, k], ray[1, k], ray[2, k], ray[3, k]
            direction[i, k, 0], direction[i, k, 1] = nx, aspect * ny
            x0, x1 = x + offsets[0] * nx, x + offsets[last] * nx
            y0, y1 = y + offsets[0] * ny, y + offsets[last] * ny
            inside = min(x0, x1) >= 0.0 and max(x0, x1) < w - 1.01 and min(y0, y1) >= 0.0 and max(y0, y1) < h - 1.01
            valid[i, k] = inside
            if inside:
                _along(image, x, y, nx, ny, u, place, scratch, grey)
                if seen == 0:
                    base = grey[0]
                seen += 1
                for j in range(SAMPLES):
                    total[j] += grey[j]
                    grey[j] -= base
                _condense(grey, functionals, numbers[i, k])
        level[i] = base
        for j in range(SAMPLES):
            mean[i, j] = total[j] / max(seen, 1)


@compiled
def _directions(wave: Array, circle: Array, sense: float, aspect: float, ray: Array) -> None:
    """Points of a projected circle and its normals there, rows x, y, nx, ny: one px of x along them is one px long.

    The normal is that on the sensor: blur and edge are round there, not in a field's lines.
    """
    for k in range(circle.shape[1]):
        c1, s1, c2, s2 = circle[0, k], circle[1, k], circle[2, k], circle[3, k]
        ray[0, k] = wave[0, 0] + wave[0, 1] * c1 + wave[0, 2] * s1 + wave[0, 3] * c2 + wave[0, 4] * s2
        ray[1, k] = wave[1, 0] + wave[1, 1] * c1 + wave[1, 2] * s1 + wave[1, 3] * c2 + wave[1, 4] * s2
        tx = wave[0, 2] * c1 - wave[0, 1] * s1 + 2.0 * (wave[0, 4] * c2 - wave[0, 3] * s2)
        ty = aspect * (wave[1, 2] * c1 - wave[1, 1] * s1 + 2.0 * (wave[1, 4] * c2 - wave[1, 3] * s2))
        scale = sense / math.sqrt(tx * tx + ty * ty)
        ray[2, k], ray[3, k] = ty * scale, -tx * scale / aspect


@compiled
def _project_circle(v: Array, R: Array, t: Array, x: float, y: float, radius_mm: float, wave: Array) -> float:
    """Project a circle as a trigonometric polynomial of second order, (2, 5), through NODES of its points.

    Gives the sense it runs in, +1 or -1, or 0 where a point has no image.
    """
    for p in range(5):
        wave[0, p], wave[1, p] = 0.0, 0.0
    for j in range(NODES):
        px, py = project_point(v, R, t, x + radius_mm * NODE_WAVES[j, 1], y + radius_mm * NODE_WAVES[j, 2], 0.0)
        if math.isnan(px):
            return 0.0
        for p in range(5):
            share = (2.0 if p else 1.0) / NODES * NODE_WAVES[j, p]
            wave[0, p] += share * px
            wave[1, p] += share * py
    return 1.0 if wave[0, 1] * wave[1, 2] - wave[0, 2] * wave[1, 1] > 0.0 else -1.0


@compiled
def _along(
    image: Image, x: float, y: float, nx: float, ny: float, offsets: NDArray[np.float32], place: NDArray[np.int32],
    scratch: NDArray[np.float32], grey: NDArray[np.float32],
) -> None:  # fmt: skip
    """Bilinear grey values at (x, y) + offsets * n; in three loops, of which two run eight at a time."""
    width = np.int32(image.shape[1])
    flat = image.reshape(-1)
    x0, y0, dx, dy = np.float32(x), np.float32(y), np.float32(nx), np.float32(ny)
    fx, fy, p, q, r, s = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5]
    for j in range(SAMPLES):
        xs, ys = x0 + offsets[j] * dx, y0 + offsets[j] * dy
        ix, iy = np.int32(xs), np.int32(ys)
        fx[j], fy[j] = xs - np.float32(ix), ys - np.float32(iy)
        place[j] = iy * width + ix
    for j in range(SAMPLES):
        k = np.uint32(place[j])
        below = k + np.uint32(width)
        p[j], q[j], r[j], s[j] = flat[k], flat[k + np.uint32(1)], flat[below], flat[below + np.uint32(1)]
    for j in range(SAMPLES):
        top = p[j] + fx[j] * (q[j] - p[j])
        grey[j] = top + fy[j] * (r[j] + fx[j] * (s[j] - r[j]) - top)


@compiled
def _condense(grey: NDArray[np.float32], functionals: NDArray[np.float32], numbers: NDArray[np.float32]) -> None:
    """A ray's NUMBERS."""
    a, b, c, d, e, square = (
        np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    )  # fmt: skip
    for j in range(SAMPLES):
        y = grey[j]
        a += functionals[0, j] * y
        b += functionals[1, j] * y
        c += functionals[2, j] * y
        d += functionals[3, j] * y
        e += functionals[4, j] * y
        square += functionals[BASIS, j] * y * y
    numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[ENERGY] = a, b, c, d, e, square
    numbers[BORE] = (grey[0] + grey[1] + grey[2]) / np.float32(INNER)
    numbers[OUTSIDE] = (grey[SAMPLES - 2] + grey[SAMPLES - 1]) / np.float32(OUTER)
    numbers[NOISE] = grey[0] - np.float32(2.0) * grey[1] + grey[2]
