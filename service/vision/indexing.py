"""Give blobs their lattice index, with no pose known: seed on a complete star of neighbours, and grow.

Blobs never disappear: what does not fit stays unindexed, and a later pass with a pose may take it up.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]
    Ints: TypeAlias = NDArray[np.int64]

__all__ = ["UNINDEXED", "index_blobs"]

UNINDEXED = -10_000
NEIGHBOURS = 12
STARS = 500
"""Blobs, the strongest ones, about which a star is looked for."""
SEEDS = 12
WHOLE = 0.75
"""Share of its places' neighbours that a lattice over most of the blobs holds, for no other to be looked for."""
REACH = 90
"""Largest row or column from the seed."""
TOLERANCE = 0.22
"""How far from its expected place, in lattice steps, a neighbour may stand."""

STEPS = {
    6: np.array([[0, 1], [1, 0], [1, -1], [0, -1], [-1, 0], [-1, 1]], np.int64),
    4: np.array([[0, 1], [1, 0], [0, -1], [-1, 0], [1, 1], [1, -1], [-1, -1], [-1, 1]], np.int64),
}
"""(row, column) steps of a star: the six nearest of a triangular lattice, the eight of a square one."""


def index_blobs(center_px: NDArray[np.float64], lattice: Lattice, pitch_px: float) -> tuple[NDArray[np.int64], int]:
    """Index the largest connected part of the lattice.

    Parameters
    ----------
    center_px
        (n, 2), strongest first.
    pitch_px
        Expected pitch; right within 0.6 to 1.6.

    Returns
    -------
    index
        (n, 2) int64 (row, column) from an arbitrary origin; UNINDEXED where none.
    count
        How many are indexed.
    """
    n = len(center_px)
    if n < 7:
        return np.full((n, 2), UNINDEXED, np.int64), 0
    symmetry = lattice.arrangement.symmetry
    angle = 2 * math.pi / symmetry
    return _index(np.ascontiguousarray(center_px), STEPS[symmetry], pitch_px, angle)


@compiled
def _cells(points: Array, size: float) -> tuple[Ints, Ints, int]:
    """Sort points into square cells: the points in order of cells, where each cell begins, and cells in a row."""
    n = points.shape[0]
    left, top = points[:, 0].min(), points[:, 1].min()
    across, down = int((points[:, 0].max() - left) / size) + 3, int((points[:, 1].max() - top) / size) + 3
    cell, begin = np.empty(n, np.int64), np.zeros(across * down + 1, np.int64)
    for i in range(n):  # a margin of empty cells all around
        cell[i] = (int((points[i, 1] - top) / size) + 1) * across + int((points[i, 0] - left) / size) + 1
        begin[cell[i] + 1] += 1
    for c in range(across * down):
        begin[c + 1] += begin[c]
    order, placed = np.empty(n, np.int64), begin.copy()
    for i in range(n):
        order[placed[cell[i]]] = i
        placed[cell[i]] += 1
    return order, begin, across


@compiled
def _nearest(points: Array, reach: float) -> Ints:
    """Indices, (n, NEIGHBOURS), of each point's nearest others within `reach`, nearest first; -1 where fewer."""
    n = points.shape[0]
    out, far = np.full((n, NEIGHBOURS), -1, np.int64), np.full((n, NEIGHBOURS), reach * reach)
    size = max(reach, (np.ptp(points[:, 0]) + np.ptp(points[:, 1])) / n)
    order, begin, across = _cells(points, size)
    cells = begin.shape[0] - 1
    for c in range(across + 1, cells - across - 1):
        for row in range(-1, 2):
            first, last = begin[c + row * across - 1], begin[c + row * across + 2]
            for k in range(begin[c], begin[c + 1]):
                for m in range(first, last):
                    _keep_nearest(points, order[k], order[m], out, far)
    return out


@compiled
def _keep_nearest(points: Array, i: int, j: int, out: Ints, far: Array) -> None:
    """Take j among the nearest of i, if it is one."""
    dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    d = dx * dx + dy * dy
    if j == i or d >= far[i, NEIGHBOURS - 1]:
        return
    k = NEIGHBOURS - 1
    while k > 0 and far[i, k - 1] > d:
        far[i, k], out[i, k] = far[i, k - 1], out[i, k - 1]
        k -= 1
    far[i, k], out[i, k] = d, j


@compiled
def _at(points: Array, near: Ints, i: int, x: float, y: float, tolerance: float) -> int:
    """The neighbour of `i` that stands within `tolerance` px of (x, y), or -1."""
    best, who = tolerance * tolerance, -1
    for k in range(NEIGHBOURS):
        j = near[i, k]
        if j < 0:
            break
        d = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2
        if d < best:
            best, who = d, j
    return who


@compiled
def _star(points: Array, near: Ints, i: int, steps: Ints, pitch: float, angle: float, basis: Array) -> float:
    """Find the best local basis, (2, 2) rows a1 a2 px, about one blob; gives how well its star is filled, 0 to 1."""
    x, y, length, count = np.empty(NEIGHBOURS), np.empty(NEIGHBOURS), np.empty(NEIGHBOURS), 0
    for p in range(NEIGHBOURS):
        j = near[i, p]
        if j < 0:
            break
        x[p], y[p] = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        length[p] = math.hypot(x[p], y[p])
        count += 1
    best, c, s = 0.0, math.cos(angle), math.sin(angle)
    for p in range(count):
        la = length[p]
        if la < 0.6 * pitch or la > 1.6 * pitch:
            continue
        for q in range(count):
            lb = length[q]
            if lb < 0.6 * pitch or lb > 1.6 * pitch or lb < 0.6 * la or la < 0.6 * lb:
                continue
            along = c * (x[p] * x[q] + y[p] * y[q]) + s * (x[p] * y[q] - y[p] * x[q])
            if along < math.cos(0.5) * la * lb:
                continue
            filled = _filled(x[:count], y[:count], p, q, steps, min(la, lb)) - 0.1 * (la + lb) / pitch / 2.0
            if filled > best:  # of two that fit, the shorter
                best = filled
                basis[0, 0], basis[0, 1], basis[1, 0], basis[1, 1] = x[p], y[p], x[q], y[q]
    return best


@compiled
def _filled(x: Array, y: Array, p: int, q: int, steps: Ints, short: float) -> float:
    """How well the neighbours at (x, y) fill the star that two of them span, 0 to 1."""
    filled = 0.0
    for s in range(steps.shape[0]):
        to_x, to_y = steps[s, 1] * x[p] + steps[s, 0] * x[q], steps[s, 1] * y[p] + steps[s, 0] * y[q]
        best = (TOLERANCE * short) ** 2
        nearest = best
        for k in range(x.shape[0]):
            nearest = min(nearest, (x[k] - to_x) ** 2 + (y[k] - to_y) ** 2)
        if nearest < best:
            filled += 1.0 - math.sqrt(nearest) / short
    return float(filled / steps.shape[0])


@compiled
def _grow(points: Array, near: Ints, seed: int, start: Array, steps: Ints, index: Ints) -> tuple[int, int]:
    """Index all that is connected to `seed`; each blob carries a local basis that follows perspective and lens.

    Gives how many are indexed, and how many links join them: a wrong lattice may reach every blob, but leaves half of
    its own sites empty.
    """
    n = points.shape[0]
    index[:] = UNINDEXED
    who = np.full((2 * REACH + 1, 2 * REACH + 1), -1, np.int64)
    basis = np.empty((n, 2, 2))
    queue = np.empty(n, np.int64)
    queue[0], head, tail = seed, 0, 1
    index[seed, 0] = index[seed, 1] = 0
    who[REACH, REACH] = seed
    basis[seed] = start
    while head < tail:
        i = queue[head]
        head += 1
        # the basis here: the parent's, drawn towards what the neighbours that are indexed already say
        nrr, nrc, ncc = 1.0, 0.0, 1.0
        rx, ry, cx, cy = basis[i, 1, 0], basis[i, 1, 1], basis[i, 0, 0], basis[i, 0, 1]
        for s in range(steps.shape[0]):
            r, c = index[i, 0] + steps[s, 0], index[i, 1] + steps[s, 1]
            if abs(r) > REACH or abs(c) > REACH:
                continue
            j = who[r + REACH, c + REACH]
            if j >= 0:
                dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
                nrr += steps[s, 0] * steps[s, 0]
                nrc += steps[s, 0] * steps[s, 1]
                ncc += steps[s, 1] * steps[s, 1]
                rx += steps[s, 0] * dx
                ry += steps[s, 0] * dy
                cx += steps[s, 1] * dx
                cy += steps[s, 1] * dy
        det = nrr * ncc - nrc * nrc
        bx, by = (ncc * rx - nrc * cx) / det, (ncc * ry - nrc * cy) / det
        ax, ay = (nrr * cx - nrc * rx) / det, (nrr * cy - nrc * ry) / det
        basis[i, 0, 0], basis[i, 0, 1], basis[i, 1, 0], basis[i, 1, 1] = ax, ay, bx, by
        short = min(math.hypot(ax, ay), math.hypot(bx, by))
        for s in range(steps.shape[0]):
            r, c = index[i, 0] + steps[s, 0], index[i, 1] + steps[s, 1]
            if abs(r) > REACH or abs(c) > REACH or who[r + REACH, c + REACH] >= 0:
                continue
            x = points[i, 0] + steps[s, 1] * ax + steps[s, 0] * bx
            y = points[i, 1] + steps[s, 1] * ay + steps[s, 0] * by
            j = _at(points, near, i, x, y, TOLERANCE * short)
            if j >= 0 and index[j, 0] == UNINDEXED:
                index[j, 0], index[j, 1] = r, c
                who[r + REACH, c + REACH] = j
                basis[j] = basis[i]
                queue[tail] = j
                tail += 1
    links = 0
    for k in range(tail):
        i = queue[k]
        for s in range(steps.shape[0]):
            r, c = index[i, 0] + steps[s, 0] + REACH, index[i, 1] + steps[s, 1] + REACH
            if 0 <= r <= 2 * REACH and 0 <= c <= 2 * REACH and who[r, c] >= 0:
                links += 1
    return tail, links


@compiled
def _index(points: Array, steps: Ints, pitch: float, angle: float) -> tuple[Ints, int]:
    n = points.shape[0]
    near = _nearest(points, 2.4 * pitch)
    quality, basis = np.zeros(n), np.empty((n, 2, 2))
    for i in range(min(n, STARS)):
        quality[i] = _star(points, near, i, steps, pitch, angle, basis[i])
    best, count, most = np.full((n, 2), UNINDEXED, np.int64), 0, 0
    trial, used = np.empty((n, 2), np.int64), np.zeros(n, np.bool_)
    for _ in range(SEEDS):
        seed = -1
        for i in range(n):
            if not used[i] and quality[i] > 0.45 and (seed < 0 or quality[i] > quality[seed]):
                seed = i
        if seed < 0:
            break
        size, links = _grow(points, near, seed, basis[seed], steps, trial)
        for i in range(n):
            if trial[i, 0] != UNINDEXED:
                used[i] = True
        if links > most:
            count, most = size, links
            best[:] = trial
        if 2 * size > n and links > WHOLE * steps.shape[0] * size:
            break
    return best, count
