"""The paper's steps 7 and 8: straight lines through linked centres, and where they meet in the dark region."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from service.vision.lattice import Lattice

    Points: TypeAlias = NDArray[np.float64]
    Indices: TypeAlias = NDArray[np.int64]

__all__ = ["Crossings", "Line", "crossings", "fit_line", "fit_lines", "lines_of_a_site"]

FEWEST_ON_A_LINE = 3
"""Two points make a line but say nothing of its straightness."""


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A straight line in the picture.

    Attributes
    ----------
    direction_deg
        Its direction in the lattice, from a1 on: 0, 60 or 120; 0 or 90 on a square one.
    number
        Which of the parallel lines of the lattice it is.
    anchor_px, unit
        (2,) weighted mean of its points and (2,) direction.
    covariance
        (2, 2) of the anchor's offset along the line's normal (px) and of the direction (rad). Diagonal, as about the
        weighted mean the two are independent.
    chi_square, points
        Of its fit.
    """

    direction_deg: int
    number: int
    anchor_px: Points
    unit: Points
    covariance: Points
    chi_square: float
    points: int

    @property
    def normal(self) -> Points:
        """Unit normal, (2,)."""
        return np.array([-self.unit[1], self.unit[0]])

    def variance_px2(self, point_px: Points) -> float:
        """Variance of the line's place across its direction where it passes `point_px`."""
        lever = np.array([1.0, (point_px - self.anchor_px) @ self.unit])
        return float(lever @ self.covariance @ lever)


def fit_line(points_px: Points, sigma_px: NDArray[np.float64], direction_deg: int = 0, number: int = 0) -> Line:
    """Step 7: the line of least chi-square through (n, 2) points, n >= 2, each with one sigma per axis.

    chi-square sums squared distances across the line over sigma squared; its minimum is the main axis of the weighted
    scatter.
    """
    weight = sigma_px**-2.0
    anchor = weight @ points_px / weight.sum()
    arm = points_px - anchor
    _, vectors = np.linalg.eigh((arm * weight[:, None]).T @ arm)
    unit = vectors[:, 1] * (1.0 if vectors[:, 1] @ (points_px[-1] - points_px[0]) >= 0 else -1.0)
    along, across = arm @ unit, arm @ np.array([-unit[1], unit[0]])
    covariance = np.diag([1 / weight.sum(), 1 / (weight @ along**2)])
    return Line(direction_deg, number, anchor, unit, covariance, float(weight @ across**2), len(points_px))


def lines_of_a_site(site: Indices, lattice: Lattice) -> dict[int, Indices]:
    """Numbers, (n,), of the lattice lines through (n, 2) sites (row, column), by the lines' direction in deg."""
    row, column = site.T
    if lattice.arrangement.symmetry == 6:
        return {0: row, 60: column, 120: row + column}
    return {0: row, 90: column}


def fit_lines(points_px: Points, sigma_px: NDArray[np.float64], site: Indices, lattice: Lattice) -> list[Line]:
    """Step 7: lines at 0, 60 and 120 deg (0 and 90 on square lattices) through all sites that have a centre.

    Where the points scatter more than their sigmas say, all covariances grow by the common chi-square per degree of
    freedom: the tubes' own scatter is in no sigma of a contour.
    """
    found = []
    for direction, numbers in lines_of_a_site(site, lattice).items():
        for number in np.unique(numbers).tolist():
            mine = numbers == number
            if mine.sum() >= FEWEST_ON_A_LINE:
                found.append(fit_line(points_px[mine], sigma_px[mine], direction, number))
    freedom = sum(line.points - 2 for line in found)
    excess = max(1.0, sum(line.chi_square for line in found) / freedom) if freedom else 1.0
    return [replace(line, covariance=line.covariance * excess) for line in found]


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """Where lines meet: `site` (n, 2) int64 (row, column), `center_px` (n, 2), `covariance_px2` (n, 2, 2)."""

    site: Indices
    center_px: Points
    covariance_px2: Points

    def without(self, site: Indices) -> Crossings:
        """Those at other places than the (n, 2) sites."""
        taken = set(map(tuple, site.tolist()))
        free = np.array([tuple(s) not in taken for s in self.site.tolist()], bool)
        return Crossings(self.site[free], self.center_px[free], self.covariance_px2[free])


def crossings(lines: Sequence[Line], size_px: tuple[int, int], lattice: Lattice) -> Crossings:
    """Step 8: the intersections of the lines, at every lattice site in the picture that two or more of them pass.

    Two lattice lines share one site only, so at a site without a centre of its own their errors are independent.
    """
    by_number = {(line.direction_deg, line.number): line for line in lines}
    found = []
    for place in _sites(lines):
        numbers = lines_of_a_site(np.array([place]), lattice)
        here = [by_number[key] for d, n in numbers.items() if (key := (d, int(n[0]))) in by_number]
        if len(here) >= 2:
            point, covariance = _meet(here)
            if np.all((point >= -0.5) & (point < np.array(size_px) - 0.5)):
                found.append((place, point, covariance))
    return Crossings(
        np.array([f[0] for f in found], np.int64).reshape(-1, 2),
        np.array([f[1] for f in found]).reshape(-1, 2),
        np.array([f[2] for f in found]).reshape(-1, 2, 2),
    )


def _sites(lines: Iterable[Line]) -> set[tuple[int, int]]:
    """Sites (row, column) where two lines of the lattice meet."""
    rows, columns, sums = ({line.number for line in lines if line.direction_deg in d} for d in ((0,), (60, 90), (120,)))
    return (
        set(product(rows, columns))
        | {(r, s - r) for r, s in product(rows, sums)}
        | {(s - c, c) for c, s in product(columns, sums)}
    )


def _meet(lines: Sequence[Line]) -> tuple[Points, Points]:
    """Point of least chi-square to two or more lines, (2,), and its covariance, (2, 2)."""
    normals = np.array([line.normal for line in lines])
    offsets = np.array([line.normal @ line.anchor_px for line in lines])
    point = np.linalg.lstsq(normals, offsets, rcond=None)[0]
    for _ in range(2):  # the weights depend on the place, weakly
        weight = np.array([1 / line.variance_px2(point) for line in lines])
        covariance = np.linalg.inv((normals * weight[:, None]).T @ normals)
        point = covariance @ (normals.T @ (weight * offsets))
    return point, covariance
