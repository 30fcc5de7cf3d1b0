"""Which lattice places a pose puts into the picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled
from service.vision.projection import project_point, undistort_point

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Sites", "lattice_places", "numbered", "sites_in_picture"]

BORDER = 48
"""Points of the picture's border that are traced back to the sheet."""
REACH = 100
"""Most rows or columns from where the picture's middle looks: a whole tubesheet has fewer across."""
MANY = 1 << 32
"""More columns than there are."""
FARTHEST = 5000.0
"""Rows or columns from the origin beyond which a point counts as at the horizon."""
FAR = 6.0
"""A border ray that meets the sheet beyond this many times the middle's depth is taken as looking past it."""


@dataclass(frozen=True, slots=True, eq=False)
class Sites:
    """Lattice places, one a row.

    Attributes
    ----------
    row, column
        (n,) int64.
    sheet_mm
        (n, 2) nominal places.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    sheet_mm: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.row)

    def take(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> Sites:
        """A selection."""
        return Sites(self.row[which], self.column[which], self.sheet_mm[which])


def sites_in_picture(
    vector: Array, rotation: Array, translation_mm: Array, lattice: Lattice, size_px: tuple[int, int], margin_px: float
) -> Sites:
    """Lattice places whose centre lies in the picture, or within `margin_px` of it (negative: at least that far in)."""
    return Sites(*_sites(vector, rotation, translation_mm, lattice.basis_mm, size_px[0], size_px[1], margin_px))


def numbered(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for each place; it rises along sites, and steps between places add up as their rows and columns do."""
    return row * MANY + column


@compiled
def lattice_places(v: Array, R: Array, t: Array, basis: Array, points_px: Array) -> tuple[NDArray[np.int64], Array]:
    """Which lattice place each picture point, (n, 2) px, shows under a pose.

    Returns
    -------
    index
        (n, 2) row and column of the place.
    off_mm
        (n,) how far from it the point lies in the sheet; infinite where it shows no place.
    """
    n = points_px.shape[0]
    index, off = np.zeros((n, 2), np.int64), np.full(n, np.inf)
    inverse = np.linalg.inv(basis)
    height = R[0, 2] * t[0] + R[1, 2] * t[1] + R[2, 2] * t[2]
    for i in range(n):
        u, w = undistort_point(v, (points_px[i, 0] - v[2]) / v[0], (points_px[i, 1] - v[3]) / v[1])
        depth = height / (R[0, 2] * u + R[1, 2] * w + R[2, 2])
        if not depth > 0.0:  # NaN as well
            continue
        dx, dy, dz = u * depth - t[0], w * depth - t[1], depth - t[2]
        x, y = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz, R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        column, row = x * inverse[0, 0] + y * inverse[1, 0], x * inverse[0, 1] + y * inverse[1, 1]
        if not max(abs(column), abs(row)) < FARTHEST:
            continue
        c, r = np.rint(column), np.rint(row)
        index[i, 0], index[i, 1] = int(r), int(c)
        x, y = (
            (column - c) * basis[0, 0] + (row - r) * basis[1, 0],
            (column - c) * basis[0, 1] + (row - r) * basis[1, 1],
        )
        off[i] = math.hypot(x, y)
    return index, off


@compiled
def _bounds(
    v: Array, R: Array, t: Array, basis: Array, width: int, height: int, margin: float
) -> tuple[int, int, int, int]:
    """Least and greatest row and column that the picture's border looks at."""
    det = basis[0, 0] * basis[1, 1] - basis[0, 1] * basis[1, 0]
    middle_depth = math.nan
    low_r, high_r, low_c, high_c = math.inf, -math.inf, math.inf, -math.inf
    mid_r, mid_c = 0.0, 0.0
    for k in range(BORDER + 1):
        if k == 0:
            x, y = 0.5 * (width - 1), 0.5 * (height - 1)
        else:
            a = 4.0 * (k - 1) / BORDER
            side, s = int(a), a - int(a)
            left, right, top, bottom = -0.5 - margin, width - 0.5 + margin, -0.5 - margin, height - 0.5 + margin
            x = left + (right - left) * (s if side == 0 else 1.0 if side == 1 else 1.0 - s if side == 2 else 0.0)
            y = top + (bottom - top) * (0.0 if side == 0 else s if side == 1 else 1.0 if side == 2 else 1.0 - s)
        u, w = undistort_point(v, (x - v[2]) / v[0], (y - v[3]) / v[1])
        if math.isnan(u):
            u, w = 3.0 * (x - v[2]) / v[0], 3.0 * (y - v[3]) / v[1]
        along = R[0, 2] * u + R[1, 2] * w + R[2, 2]
        height_mm = R[0, 2] * t[0] + R[1, 2] * t[1] + R[2, 2] * t[2]
        depth = height_mm / along
        if k == 0:
            middle_depth = depth
        elif not 0.0 < depth < FAR * middle_depth:
            depth = FAR * middle_depth
        dx, dy, dz = u * depth - t[0], w * depth - t[1], depth - t[2]
        X = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        Y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        c, r = (X * basis[1, 1] - Y * basis[1, 0]) / det, (Y * basis[0, 0] - X * basis[0, 1]) / det
        if k == 0:
            mid_r, mid_c = r, c
        low_r, high_r, low_c, high_c = min(low_r, r), max(high_r, r), min(low_c, c), max(high_c, c)
    return (
        int(max(low_r, mid_r - REACH)) - 1,
        int(min(high_r, mid_r + REACH)) + 2,
        int(max(low_c, mid_c - REACH)) - 1,
        int(min(high_c, mid_c + REACH)) + 2,
    )


@compiled
def _sites(
    v: Array, R: Array, t: Array, basis: Array, width: int, height: int, margin: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    r0, r1, c0, c1 = _bounds(v, R, t, basis, width, height, max(margin, 0.0))
    most = max(0, (r1 - r0) * (c1 - c0))
    row, column, sheet, n = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 2)), 0
    for r in range(r0, r1):
        for c in range(c0, c1):
            X, Y = c * basis[0, 0] + r * basis[1, 0], c * basis[0, 1] + r * basis[1, 1]
            x, y = project_point(v, R, t, X, Y, 0.0)
            if -margin - 0.5 <= x <= width - 0.5 + margin and -margin - 0.5 <= y <= height - 0.5 + margin:
                row[n], column[n], sheet[n, 0], sheet[n, 1] = r, c, X, Y
                n += 1
    return row[:n].copy(), column[:n].copy(), sheet[:n].copy()
