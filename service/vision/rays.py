"""Sample a picture along the normals of projected circles, and condense what each ray shows.

What is told of n circles with as many rays each stands in arrays whose last axis is the circles': kernels that take
one step for all circles before the next run many of them at a time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled
from service.vision.edges import INNER, OUTER, SAMPLES
from service.vision.projection import project_point
from service.vision.scratch import SINGLE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.edges import EdgeProfile
    from service.vision.scratch import Scratch

    Array: TypeAlias = NDArray[np.float64]
    Single: TypeAlias = NDArray[np.float32]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
    Pairs: TypeAlias = NDArray[np.uint16] | NDArray[np.uint32]
    Bits: TypeAlias = NDArray[np.uint32]

__all__ = [
    "BASIS",
    "BORE",
    "ENERGY",
    "NOISE",
    "NUMBERS",
    "OUTSIDE",
    "Rays",
    "circle_of",
    "pairs_of",
    "rays_for",
    "sample",
    "sample_rays",
    "straightening",
]

NODES = 6
"""Points of a circle that are projected exactly; a trigonometric polynomial through them gives the others."""
_ANGLE = 2 * np.pi * np.arange(NODES) / NODES
NODE_WAVES = np.column_stack([np.ones(NODES), np.cos(_ANGLE), np.sin(_ANGLE), np.cos(2 * _ANGLE), np.sin(2 * _ANGLE)])
RAY_SPACING_PX, FEWEST_RAYS, MOST_RAYS = 2.8, 16, 24
"""Rays stand this far apart on the rim, as neighbours would see the same pixels; more of them gain little."""
STRAIGHTENED = 1.0
"""A camera's grey values follow light to the power of about 0.45, but nearly straight where it is dark (BT.709). A grey
value y, as a part of full scale, is taken for ``y + STRAIGHTENED y^2``: half way back. An edge's half height then
depends less on how bright the bore is, and noise in the light, which all the way back would magnify, stays what it is
in the dark. Measured on truth; it does no harm to grey values that follow light as it is."""
BASIS = 5
"""Shapes that a ray's grey values are made of, see `shapes`."""
ENERGY, BORE, OUTSIDE, NOISE, NUMBERS = 5, 6, 7, 8, 9
"""What a ray is condensed to: its samples with each shape; with themselves; levels inside and outside; a second
difference in the bore, which only noise makes."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """What the rays of n circles showed.

    Attributes
    ----------
    numbers
        (NUMBERS, rays, n) float32, of grey values above `level`; 0 where a ray is not valid.
    direction
        (2, rays, n) float32, outward normals, of unit length where pixels are square.
    valid
        (rays, n) float32: 1 where the ray lies in the picture, else 0.
    center_px
        (n, 2) projected middles; NaN where there is none.
    mean
        (n, SAMPLES) mean grey over the valid rays.
    level
        (n,) grey.
    """

    numbers: NDArray[np.float32]
    direction: NDArray[np.float32]
    valid: NDArray[np.float32]
    center_px: NDArray[np.float64]
    mean: NDArray[np.float64]
    level: NDArray[np.float64]


@lru_cache(maxsize=64)
def circle_of(count: int) -> Array:
    """Cosine and sine of `count` angles around a circle, and of twice those, (4, count)."""
    a = 2 * np.pi * np.arange(count) / count
    return np.array([np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)])


def rays_for(circumference_px: float) -> int:
    """How many rays a rim deserves; a multiple of four, so that few sizes occur."""
    return min(max(4 * round(circumference_px / RAY_SPACING_PX / 4), FEWEST_RAYS), MOST_RAYS)


def straightening(image: Image) -> float:
    """What straightens a picture's grey values, per grey value, see `STRAIGHTENED`."""
    return STRAIGHTENED / float(np.iinfo(image.dtype).max)


def pairs_of(image: Image) -> Pairs:
    """Each pixel with its right neighbour in the higher bits, (h w - 1,), of a packed picture: half as many to load."""
    wide = {np.dtype(np.uint8): np.uint16, np.dtype(np.uint16): np.uint32}[image.dtype]
    pairs: Pairs = np.ndarray((image.size - 1,), wide, image, strides=(image.itemsize,))
    pairs.flags.writeable = False
    return pairs


def sample_rays(
    image: Image, vector: Array, rotation: Array, translation_mm: Array, sheet_mm: Array, radius_mm: float,
    profile: EdgeProfile, bend: float, functionals: NDArray[np.float32], count: int, scratch: Scratch,
) -> Rays:  # fmt: skip
    """Sample along the normals of projected circles, bilinear.

    Parameters
    ----------
    image
        (h, w) grey, C-contiguous.
    vector, rotation, translation_mm
        Intrinsics (`camera.lens_vector`) and pose.
    sheet_mm, radius_mm
        (n, 2) middles of the circles.
    profile
        Says where rays are sampled.
    bend
        A grey value y is taken for ``y + bend y^2``, see `straightening`.
    functionals
        (BASIS + 1, SAMPLES): what samples are multiplied with; the last row weighs their squares.
    count
        Rays a circle, a multiple of four.
    scratch
        Lends the memory for what is told of single rays.
    """
    n = len(sheet_mm)
    rays = Rays(
        numbers=scratch.array((NUMBERS, count, n), SINGLE), direction=scratch.array((2, count, n), SINGLE),
        valid=scratch.array((count, n), SINGLE), center_px=np.empty((n, 2)), mean=np.empty((n, SAMPLES)),
        level=np.empty(n),
    )  # fmt: skip
    sample(
        pairs_of(image), image.shape, bend, vector, rotation, translation_mm, sheet_mm, radius_mm, circle_of(count),
        profile.offsets_px, functionals, rays.numbers, rays.direction, rays.valid, rays.center_px, rays.mean,
        rays.level,
    )  # fmt: skip
    return rays


@compiled
def sample(
    pairs: Pairs, shape: tuple[int, int], bend: float, v: Array, R: Array, t: Array, sheet_mm: Array, radius_mm: float,
    circle: Array, offsets: Array, functionals: Single, numbers: Single, direction: Single, valid: Single,
    center: Array, mean: Array, level: Array,
) -> None:  # fmt: skip
    """Fill in what `Rays` holds; `pairs` are `pairs_of` a picture of that shape."""
    count = circle.shape[1]
    aspect = v[0] / v[1]
    wave, ray, inside = np.empty((2, 5)), np.empty((4, count), np.float32), np.empty(count, np.float32)
    bits, work = np.empty((3, SAMPLES * count), np.uint32), np.empty((2, SAMPLES * count), np.float32)
    grey, told = np.empty(SAMPLES * count, np.float32), np.empty((NUMBERS, count), np.float32)
    u = offsets.astype(np.float32)
    for i in range(sheet_mm.shape[0]):
        center[i, 0], center[i, 1] = project_point(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], 0.0)
        sense = _project_circle(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], radius_mm, wave)
        seen = 0
        if not math.isnan(center[i, 0]) and sense != 0.0:
            _directions(wave, circle, sense, aspect, ray)
            seen = _inside(shape[1], shape[0], ray, u, inside)
        level[i] = 0.0
        if seen == 0:
            for k in range(count):
                valid[k, i], direction[0, k, i], direction[1, k, i] = 0.0, 0.0, 0.0
                for p in range(NUMBERS):
                    numbers[p, k, i] = 0.0
            mean[i] = 0.0
            continue
        base = _along(pairs, shape[1], bend, ray, u, bits, work, grey)
        _condense(grey, functionals, told)
        for k in range(count):
            valid[k, i], direction[0, k, i], direction[1, k, i] = inside[k], ray[2, k], aspect * ray[3, k]
            for p in range(NUMBERS):
                numbers[p, k, i] = inside[k] * told[p, k]
        level[i] = base
        for j in range(SAMPLES):
            total = np.float32(0.0)
            for k in range(count):
                total += inside[k] * grey[j * count + k]
            mean[i, j] = base + total / seen


@compiled
def _directions(wave: Array, circle: Array, sense: float, aspect: float, ray: Single) -> None:
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
def _inside(width: int, height: int, ray: Single, u: Single, inside: Single) -> int:
    """Tell, and count, the rays that lie in the picture; the others are moved to its corner."""
    seen, last = 0, u.shape[0] - 1
    for k in range(ray.shape[1]):
        x0, x1 = ray[0, k] + u[0] * ray[2, k], ray[0, k] + u[last] * ray[2, k]
        y0, y1 = ray[1, k] + u[0] * ray[3, k], ray[1, k] + u[last] * ray[3, k]
        if min(x0, x1) >= 0.0 and max(x0, x1) < width - 1.01 and min(y0, y1) >= 0.0 and max(y0, y1) < height - 1.01:
            inside[k] = 1.0
            seen += 1
        else:
            inside[k] = 0.0
            ray[0, k], ray[1, k], ray[2, k], ray[3, k] = 0.0, 0.0, 0.0, 0.0
    return seen


@compiled
def _along(
    pairs: Pairs, width: int, bend: float, ray: Single, u: Single, bits: Bits, work: Single, grey: Single
) -> float:
    """Bilinear, straightened grey values along the rays, above the grey that is given: that of one of them.

    In loops of one kind of work each, for processors that do such work many at a time.
    """
    row, count, bent = np.uint32(width), ray.shape[1], np.float32(bend)
    place, upper, lower, fx, fy = bits[0], bits[1], bits[2], work[0], work[1]
    for j in range(SAMPLES):
        for k in range(count):
            x, y = ray[0, k] + u[j] * ray[2, k], ray[1, k] + u[j] * ray[3, k]
            ix, iy = np.int32(x), np.int32(y)
            fx[j * count + k], fy[j * count + k] = x - np.float32(ix), y - np.float32(iy)
            place[j * count + k] = np.uint32(iy) * row + np.uint32(ix)
    for m in range(SAMPLES * count):
        at = place[m]
        upper[m], lower[m] = pairs[at], pairs[at + row]
    depth = 4 * pairs.itemsize  # bits a pixel
    shift, left = np.uint32(depth), np.uint32((1 << depth) - 1)
    base = np.float32(0.0)
    for k in range(count):
        if ray[2, k] != 0.0 or ray[3, k] != 0.0:
            first = np.float32(np.int32(upper[k] & left))
            base = first + bent * first * first
            break
    for m in range(SAMPLES * count):
        p, q = np.float32(np.int32(upper[m] & left)), np.float32(np.int32(upper[m] >> shift))
        r, s = np.float32(np.int32(lower[m] & left)), np.float32(np.int32(lower[m] >> shift))
        top = p + fx[m] * (q - p)
        y = top + fy[m] * (r + fx[m] * (s - r) - top)
        grey[m] = y + bent * y * y - base
    return float(base)


@compiled
def _condense(grey: Single, functionals: Single, told: Single) -> None:
    """The NUMBERS of each ray, (NUMBERS, rays), of its grey values above the base."""
    count = told.shape[1]
    for p in range(BASIS):
        for k in range(count):
            told[p, k] = functionals[p, 0] * grey[k]
        for j in range(1, SAMPLES):
            for k in range(count):
                told[p, k] += functionals[p, j] * grey[j * count + k]
    for k in range(count):
        square = np.float32(0.0)
        for j in range(SAMPLES):
            square += functionals[BASIS, j] * grey[j * count + k] * grey[j * count + k]
        told[ENERGY, k] = square
        told[BORE, k] = (grey[k] + grey[count + k] + grey[2 * count + k]) / np.float32(INNER)
        told[OUTSIDE, k] = (grey[(SAMPLES - 2) * count + k] + grey[(SAMPLES - 1) * count + k]) / np.float32(OUTER)
        told[NOISE, k] = grey[k] - np.float32(2.0) * grey[count + k] + grey[2 * count + k]
