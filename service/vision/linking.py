"""The paper's linking of neighbouring tube centres, from which its lines are drawn (step 7, figure 11)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice

    Points: TypeAlias = NDArray[np.float64]
    Indices: TypeAlias = NDArray[np.int64]

__all__ = ["Links", "link"]

REACH = (0.5, 1.6)
"""Distances of possible neighbours, in pitches as the radius of the regions lets expect them."""
ALIKE = math.log(1.4)
"""How much the radii of two tubes may differ, as a logarithm."""
STEP_TOLERANCE = 0.3
"""How far a link may differ from a lattice step, in pitches."""
SITE_TOLERANCE = 0.2
"""How far a centre may lie from its lattice place when all are laid on one sheet, in pitches."""
BRIDGED = 3.0
"""How many sites wide a gap may be for centres beyond it to join; a lens bends the lattice, so not any."""
FARTHEST = 10_000
"""Lattice index beyond which a point counts as at the horizon."""
FEWEST = 6
"""Centres that a lattice takes to be believed: one more than a homography's four and its check."""


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Lattice indices of centres.

    Attributes
    ----------
    site
        (n, 2) int64, (row, column); meaningless where not `used`.
    used
        (n,) bool: whether the centre has a place in the lattice.
    reason
        Why there is no lattice, or None.
    """

    site: Indices
    used: NDArray[np.bool_]
    reason: str | None = None


def link(points_px: Points, radii_px: NDArray[np.float64], lattice: Lattice, pixel_aspect: float = 1.0) -> Links:
    """Give neighbouring centres neighbouring lattice indices.

    Each pair's distance is taken in pitches, by the radii of its two regions, so that perspective and scale drop out.
    A circular vote of the directions gives the lattice's own; a breadth-first walk over the links that agree with it
    numbers the largest patch; then what lies off the sheet is dropped and what lies on it close by admitted. Of the
    lattice's turns the one nearest to X rightwards is taken; (0, 0) is some tube.

    Parameters
    ----------
    points_px, radii_px
        (n, 2) centres and (n,) mean radii of the dark discs, the latter in px across.
    pixel_aspect
        Line pitch over pixel pitch, dy/dx.
    """
    square = points_px * (1.0, pixel_aspect)
    pairs, steps, lengths = _neighbours(square, radii_px * math.sqrt(pixel_aspect), lattice)
    if len(pairs) < FEWEST:
        return _none(
            len(square), f"{len(square)} round dark regions found, too few of them side by side to show a lattice"
        )
    basis = _basis(steps, lattice)
    if basis is None:
        return _none(len(square), "the directions between neighbours show no lattice")
    moves, fits = _moves(steps, basis, lattice)
    site, used = _walk(len(square), pairs[fits], moves[fits])
    if used.sum() < FEWEST:
        return _none(len(square), f"the largest patch of linked tubes has {used.sum()}, fewer than {FEWEST}")
    alike = np.abs(np.log(radii_px / np.median(radii_px[used]))) < ALIKE
    tolerance = SITE_TOLERANCE * float(np.median(lengths[fits]))
    site, used = _on_one_sheet(square, site, used, alike, lattice, tolerance)
    if used.sum() < FEWEST:
        return _none(len(square), f"only {used.sum()} tubes lie on one lattice, fewer than {FEWEST}")
    return Links(site, used)


def _none(count: int, reason: str) -> Links:
    return Links(np.zeros((count, 2), np.int64), np.zeros(count, bool), reason)


def _neighbours(points: Points, radii: NDArray[np.float64], lattice: Lattice) -> tuple[Indices, Points, Points]:
    """Pairs (i, j) that may be neighbours, (m, 2), their steps in pitches, (m, 2), and lengths, (m,)."""
    empty = np.zeros((0, 2), np.int64), np.zeros((0, 2)), np.zeros(0)
    if len(points) < 2:
        return empty
    expected = radii * lattice.pitch_mm / lattice.rim_radius_mm
    pairs = cKDTree(points).query_pairs(REACH[1] * float(np.percentile(expected, 90)), output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]]).astype(np.int64)
    step = points[pairs[:, 1]] - points[pairs[:, 0]]
    length = np.hypot(*step.T)
    own = (expected[pairs[:, 0]] + expected[pairs[:, 1]]) / 2
    alike = np.abs(np.log(expected[pairs[:, 0]] / expected[pairs[:, 1]])) < ALIKE
    near = alike & (length > REACH[0] * own) & (length < REACH[1] * own)
    if not near.any():
        return empty
    pairs, step, length, own = pairs[near], step[near], length[near], own[near]
    nearest = np.full(len(points), np.inf)
    np.minimum.at(nearest, pairs[:, 0], length / own)
    pitches = own * float(np.median(nearest[np.isfinite(nearest)]))  # dark discs look smaller than the rims are
    return pairs, step / pitches[:, None], length


def _basis(steps: Points, lattice: Lattice) -> Points | None:
    """Lattice vectors in the picture, (2, 2) rows a1 and a2, in pitches; None where no direction stands out."""
    n = lattice.arrangement.symmetry
    short = steps[np.abs(np.hypot(*steps.T) - 1) < STEP_TOLERANCE]
    if len(short) < FEWEST:
        return None
    vote = np.exp(1j * n * np.arctan2(short[:, 1], short[:, 0])).mean()
    nominal = lattice.basis_mm / lattice.pitch_mm
    first = n * math.atan2(nominal[0, 1], nominal[0, 0])
    turn = float(np.angle(vote * np.exp(-1j * first))) / n  # the smallest turn: X stays nearest to rightwards
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    basis = nominal @ rotation
    for _ in range(3):
        moves, fits = _moves(short, basis, lattice)
        if fits.sum() < FEWEST or np.linalg.matrix_rank(moves[fits]) < 2:
            return None
        basis = np.linalg.lstsq(moves[fits][:, ::-1].astype(float), short[fits])[0]
    return np.asarray(basis)


def _moves(steps: Points, basis: Points, lattice: Lattice) -> tuple[Indices, NDArray[np.bool_]]:
    """Which lattice step, (row, column), each step is nearest to, and whether near enough."""
    unit = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])
    if lattice.arrangement.symmetry == 6:
        unit = np.concatenate([unit, [(1, -1), (-1, 1)]])
    off = np.linalg.norm(steps[:, None] - (unit[:, ::-1] @ basis)[None], axis=2)
    return unit[off.argmin(axis=1)], off.min(axis=1) < STEP_TOLERANCE


def _walk(count: int, pairs: Indices, moves: Indices) -> tuple[Indices, NDArray[np.bool_]]:
    """Number the largest patch of linked points, breadth first."""
    out: list[list[tuple[int, int, int]]] = [[] for _ in range(count)]
    for (i, j), (row, column) in zip(pairs.tolist(), moves.tolist(), strict=True):
        out[i].append((j, row, column))
    seen: set[int] = set()
    best: dict[int, tuple[int, int]] = {}
    for start in range(count):
        if start in seen:
            continue
        patch = {start: (0, 0)}
        queue = deque([start])
        while queue:
            i = queue.popleft()
            for j, row, column in out[i]:
                if j not in patch:
                    patch[j] = (patch[i][0] + row, patch[i][1] + column)
                    queue.append(j)
        seen |= patch.keys()
        best = max(best, patch, key=len)
    site, used = np.zeros((count, 2), np.int64), np.zeros(count, bool)
    for i, place in best.items():
        site[i], used[i] = place, True
    return site, used


def _on_one_sheet(
    points: Points,
    site: Indices,
    used: NDArray[np.bool_],
    alike: NDArray[np.bool_],
    lattice: Lattice,
    tolerance: float,
) -> tuple[Indices, NDArray[np.bool_]]:
    """Drop what lies off its place in the lattice; admit what is `alike` and lies on a place near the patch."""
    placed = used
    for _ in range(3):
        sheet = lattice.sheet_points(*site[used].T)
        picture_from_sheet, _ = cv2.findHomography(sheet, points[used], cv2.RANSAC, tolerance)
        if picture_from_sheet is None or abs(np.linalg.det(picture_from_sheet)) < 1e-12:
            return site, np.zeros_like(used)
        back = cv2.perspectiveTransform(points[None], np.linalg.inv(picture_from_sheet))[0]
        rounded = np.rint(np.clip(lattice.lattice_coordinates(back), -FARTHEST, FARTHEST)).astype(np.int64)
        site = np.where(placed[:, None], site, rounded)
        place = cv2.perspectiveTransform(lattice.sheet_points(*site.T)[None], picture_from_sheet)[0]
        off = np.hypot(*(points - place).T)
        near = alike & (cKDTree(site[used]).query(site)[0] <= BRIDGED)
        used = _nearest_of_each_site(site, off) & (off < tolerance) & near
        placed = placed | used
        if used.sum() < FEWEST:
            break
    return site, used


def _nearest_of_each_site(site: Indices, off: NDArray[np.float64]) -> NDArray[np.bool_]:
    """One point a site: True for the one that lies nearest to it."""
    order = np.lexsort((off, site[:, 1], site[:, 0]))
    first = np.r_[True, (np.diff(site[order], axis=0) != 0).any(axis=1)]
    mine = np.zeros(len(site), bool)
    mine[order[first]] = True
    return mine
