"""Find dark discs of about a known size: where tubes may be, before any pose is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, cast

import cv2
import numpy as np

from service.vision.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]
    Floats: TypeAlias = NDArray[np.float32]
    Ints: TypeAlias = NDArray[np.int64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["DISC_RADIUS_PX", "Blobs", "find_blobs"]

DISC_RADIUS_PX = 3.3
"""Radius that discs are shrunk to: large enough for the filter, small enough to be fast at any picture size. Discs of
5.5 px are found no better, at almost thrice the cost."""
ASIDE = int(3.2 * DISC_RADIUS_PX)
"""Half the side, less one, of the box that light is evened out over: it is wider than a pitch."""
HALF = 10
"""Rows or columns to each side that the Gaussians reach over: three sigma of the wider."""
MOST_DEVIATION = 2.5
"""Local standard deviations that a grey value counts for at the most."""
REACH = int(0.9 * DISC_RADIUS_PX)
"""How near to each other, in px, two discs may not be."""
RING = 32
"""Rows that are kept, a power of two: enough for the Gaussians."""
THRESHOLD = 0.12
"""Least response, in local standard deviations; a noise-free disc on its plate gives about 1."""


def _gaussian(sigma: float) -> NDArray[np.float32]:
    """Weights of the middle and of every pair of neighbours at the same distance; all samples together count one."""
    weight = np.exp(-0.5 * (np.arange(HALF + 1) / sigma) ** 2)
    return np.asarray(weight / (2 * weight.sum() - weight[0]), np.float32)


WIDE, NARROW = _gaussian(1.6 * 0.6 * DISC_RADIUS_PX), _gaussian(0.6 * DISC_RADIUS_PX)


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Dark discs, strongest first.

    Attributes
    ----------
    center_px
        (n, 2) float64 in the picture's pixels.
    response
        (n,) float64 in local standard deviations.
    """

    center_px: NDArray[np.float64]
    response: NDArray[np.float64]


def find_blobs(
    image: NDArray[np.uint8] | NDArray[np.uint16], radius_px: tuple[float, float], limit: int = 1500
) -> Blobs:
    """Find dark discs by difference of Gaussians on the locally normalised picture.

    Local normalisation makes up for uneven light; a 3x3 median takes specks away.

    Parameters
    ----------
    image
        (h, w) grey.
    radius_px
        Expected (horizontal, vertical) radius: they differ in a single field.
    limit
        Most blobs to give.
    """
    h, w = image.shape
    size = max(16, round(w * DISC_RADIUS_PX / radius_px[0])), max(16, round(h * DISC_RADIUS_PX / radius_px[1]))
    far_smaller = 2 * size[0] < w and 2 * size[1] < h
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if far_smaller else cv2.INTER_LINEAR)
    grey = cast("Image", cv2.medianBlur(small, 3))
    x, y, peak = _discs(grey, 2.0 if image.dtype == np.uint8 else 2.0 * 257)
    order = np.argsort(-peak, kind="stable")[:limit]
    center = np.column_stack([(x + 0.5) * (w / size[0]) - 0.5, (y + 0.5) * (h / size[1]) - 0.5])
    return Blobs(center[order], peak[order])


@compiled
def _discs(grey: Image, floor: float) -> tuple[Array, Array, Array]:
    """Places x, y of the discs and their responses, each (n,).

    The picture streams through: what one row needs of others is kept in rings of rows, as to touch fresh memory for
    whole pictures would take longer than the arithmetic.
    """
    h, w = grey.shape
    total, square = np.zeros(w, np.int64), np.zeros(w, np.int64)
    even, response = np.empty((RING, w), np.float32), np.zeros((RING, w), np.float32)
    wide, narrow = np.empty(w + 2 * HALF, np.float32), np.empty(w + 2 * HALF, np.float32)
    x, y, peak, n = np.empty(h * w // 4 + 1), np.empty(h * w // 4 + 1), np.empty(h * w // 4 + 1), 0
    for i in range(min(ASIDE, h)):
        _count(grey[i], 1, total, square)
    for step in range(h + HALF + REACH):
        if step < h:
            if step + ASIDE < h:
                _count(grey[step + ASIDE], 1, total, square)
            if step - ASIDE > 0:
                _count(grey[step - ASIDE - 1], -1, total, square)
            rows = min(step + ASIDE + 1, h) - max(step - ASIDE, 0)
            _even_out(grey[step], total, square, rows, floor, even[step % RING])
        i = step - HALF
        if 0 <= i < h:
            _respond(even, i, h, wide, narrow, response[i % RING])
        i -= REACH
        if 1 <= i < h - 1:
            n = _maxima(response, i, h, x, y, peak, n)
    return x[:n].copy(), y[:n].copy(), peak[:n].copy()


@compiled
def _count(row: Image, sign: int, total: Ints, square: Ints) -> None:
    """Take a row into the columns' sums, or out of them."""
    for j in range(row.shape[0]):
        g = np.int64(row[j])
        total[j] += sign * g
        square[j] += sign * g * g


@compiled
def _even_out(row: Image, total: Ints, square: Ints, rows: int, floor: float, even: Floats) -> None:
    """Turn a row's grey values into local standard deviations from the local mean."""
    w = row.shape[0]
    sums, squares = np.zeros(w + 2 * ASIDE + 1, np.int64), np.zeros(w + 2 * ASIDE + 1, np.int64)
    a, b = np.int64(0), np.int64(0)
    for j in range(w):
        a += total[j]
        b += square[j]
        sums[j + ASIDE + 1], squares[j + ASIDE + 1] = a, b
    sums[w + ASIDE + 1 :], squares[w + ASIDE + 1 :] = a, b
    for j in range(w):
        columns = min(j + ASIDE + 1, w) - max(j - ASIDE, 0)
        share = np.float32(1.0) / np.float32(rows * columns)
        mean = np.float32(sums[j + 2 * ASIDE + 1] - sums[j]) * share
        variance = np.float32(squares[j + 2 * ASIDE + 1] - squares[j]) * share - mean * mean
        z = (np.float32(row[j]) - mean) / (np.sqrt(max(variance, np.float32(0.0))) + np.float32(floor))
        even[j] = min(max(z, np.float32(-MOST_DEVIATION)), np.float32(MOST_DEVIATION))


@compiled
def _respond(even: Floats, i: int, h: int, wide: Floats, narrow: Floats, response: Floats) -> None:
    """Difference of the two Gaussians along row i, in both directions; beyond the border its last row goes on."""
    w = response.shape[0]
    middle = even[i % RING]
    for j in range(w):
        wide[HALF + j], narrow[HALF + j] = WIDE[0] * middle[j], NARROW[0] * middle[j]
    for k in range(1, HALF + 1):
        above, below = even[max(i - k, 0) % RING], even[min(i + k, h - 1) % RING]
        for j in range(w):
            both = above[j] + below[j]
            wide[HALF + j] += WIDE[k] * both
            narrow[HALF + j] += NARROW[k] * both
    wide[:HALF], narrow[:HALF] = wide[HALF], narrow[HALF]
    wide[HALF + w :], narrow[HALF + w :] = wide[HALF + w - 1], narrow[HALF + w - 1]
    for j in range(w):
        a, b = WIDE[0] * wide[HALF + j], NARROW[0] * narrow[HALF + j]
        for k in range(1, HALF + 1):
            a += WIDE[k] * (wide[HALF + j - k] + wide[HALF + j + k])
            b += NARROW[k] * (narrow[HALF + j - k] + narrow[HALF + j + k])
        response[j] = a - b


@compiled
def _maxima(response: Floats, i: int, h: int, x: Array, y: Array, peak: Array, n: int) -> int:
    """Add row i's local maxima above THRESHOLD, each with a parabola's sub-pixel place; gives how many there are."""
    here, above, below = response[i % RING], response[(i - 1) % RING], response[(i + 1) % RING]
    for j in range(1, here.shape[0] - 1):
        c = here[j]
        if c <= THRESHOLD or c < here[j - 1] or c < here[j + 1] or c < above[j] or c < below[j]:
            continue
        if not _is_highest(response, i, j, h):
            continue
        across, down = 2.0 * (2.0 * c - here[j - 1] - here[j + 1]), 2.0 * (2.0 * c - above[j] - below[j])
        x[n] = j + min(max((here[j + 1] - here[j - 1]) / max(across, 1e-6), -0.5), 0.5)
        y[n] = i + min(max((below[j] - above[j]) / max(down, 1e-6), -0.5), 0.5)
        peak[n] = c
        n += 1
    return n


@compiled
def _is_highest(response: Floats, i: int, j: int, h: int) -> bool:
    """Whether nothing within REACH is higher, nor as high and met before."""
    for a in range(max(0, i - REACH), min(h, i + REACH + 1)):
        row = response[a % RING]
        for b in range(max(0, j - REACH), min(row.shape[0], j + REACH + 1)):
            if (a - i) ** 2 + (b - j) ** 2 > REACH * REACH + 1:
                continue
            if row[b] > response[i % RING, j] or (row[b] == response[i % RING, j] and (a < i or (a == i and b < j))):
                return False
    return True
