"""Bring a predicted pose near by a few tubes, before all of them are measured: a fraction of a full pass.

Half as many rays are told their edges' shifts one by one, as `rim_search` does, and one step of the pose follows the
tubes' shifts: with no covariances, no lattice scatter and no second look.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_in_place
from service.vision.edges import SAMPLES, start_profile
from service.vision.pose import MEDIAN_OF_TWO, POSE, damped_step, linearise, normal_equations, turned, weigh
from service.vision.rays import NUMBERS, circle_of, pairs_of, sample, straightening
from service.vision.rim_levels import COVERED, FIGURES, RADIUS, SHIFT, STRENGTH, levels
from service.vision.rim_search import REACH, find
from service.vision.rims import accepted_rims, px_per_mm
from service.vision.shapes import shapes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.edges import EdgeProfile
    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]
    Single: TypeAlias = NDArray[np.float32]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
    Pairs: TypeAlias = NDArray[np.uint16] | NDArray[np.uint32]

__all__ = ["approach", "guides_of"]

RAYS = 12
"""Rays a tube: half of what measuring takes."""
LEAST_TUBES, LEAST_SHARE = 6, 0.5
"""How many of the tubes must show."""
ROUNDS = 4
"""How often they are looked at, at the most."""
NEAR, BROAD = 1.3, 2.0
"""Edge widths off that a learnt profile reaches, and widths of the edge that is looked for beyond that."""
WELL_WITHIN = 0.6
"""Edge widths off from which one step brings tubes to where they count as settled."""
ACROSS, DOWN = 6, 4
"""Parts of the picture that have a guide each."""
REWEIGHTS = 3
LEAST_STRAY_PX = 0.02
"""Tubes never agree better than that on where the pose goes."""


def approach(
    image: Image, camera: Camera, lattice: Lattice, rotation: Array, translation_mm: Array, guides_mm: Array,
    profile: EdgeProfile, stray_px: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Bring a rough pose near by a few tubes, as far as enough of them show.

    Parameters
    ----------
    image, camera, rotation, translation_mm
        As in `refinement.refine`.
    guides_mm
        (m, 2) nominal places of the tubes.
    profile
        The learnt one.
    stray_px
        How far off the tubes are thought to lie. Where that is beyond the profile's reach, and where they are not
        found, a broader edge is looked for first.
    """
    if len(guides_mm) < LEAST_TUBES:
        return rotation, translation_mm
    least, vector = max(LEAST_TUBES, LEAST_SHARE * len(guides_mm)), camera.vector()
    wall_px = (lattice.outer_radius_mm - lattice.rim_radius_mm) * px_per_mm(vector, rotation, translation_mm, guides_mm)
    broad_px = max(BROAD * profile.width_px, stray_px)
    look = profile if stray_px < NEAR * profile.width_px else start_profile(broad_px, profile.position_px)
    for _ in range(ROUNDS):
        functionals, shapes = shapes_of(look, wall_px)
        turn, shift = np.empty((3, 3)), np.empty(3)
        seen, moved_px = _step(
            pairs_of(image), image.shape, straightening(image) if look.learnt else 0.0, vector, rotation,
            translation_mm, guides_mm, lattice.rim_radius_mm, circle_of(RAYS), look.offsets_px, functionals,
            shapes.first, shapes.edge, shapes.moved, look.width_px, look.overshot, turn, shift,
        )  # fmt: skip
        if seen < least:
            broad_px *= 1.0 if look is profile else BROAD
            look = start_profile(broad_px, profile.position_px)
            continue
        rotation, translation_mm = turn, shift
        if look is profile and moved_px < WELL_WITHIN * profile.width_px:
            break
        look = profile
    return rotation, translation_mm


@compiled
def guides_of(center_px: Array, strength: Array, used: NDArray[np.bool_], width: int, height: int) -> NDArray[np.int64]:
    """The clearest of the used tubes in each part of the picture: which of the n they are, (m,)."""
    best = np.full(ACROSS * DOWN, -1)
    for i in range(center_px.shape[0]):
        if used[i]:
            column = min(max(int(center_px[i, 0] * ACROSS / width), 0), ACROSS - 1)
            row = min(max(int(center_px[i, 1] * DOWN / height), 0), DOWN - 1)
            k = row * ACROSS + column
            if best[k] < 0 or strength[i] > strength[best[k]]:
                best[k] = i
    return best[best >= 0]


@compiled
def _step(
    pairs: Pairs, shape: tuple[int, int], bend: float, v: Array, R: Array, t: Array, guides: Array, radius_mm: float,
    circle: Array, offsets: Array, functionals: Single, first: Array, edge: Array, moved: Array, width: float,
    overshot: float, turn: Array, translation: Array,
) -> tuple[int, float]:  # fmt: skip
    """One step, into `turn` and `translation`; gives how many tubes told it, and how far it went, rms px."""
    n, count = guides.shape[0], circle.shape[1]
    numbers, direction = np.empty((NUMBERS, count, n), np.float32), np.empty((2, count, n), np.float32)
    valid, center, mean = np.empty((count, n), np.float32), np.empty((n, 2)), np.empty((n, SAMPLES))
    told, level = np.zeros((FIGURES, n)), np.empty(n)
    sample(
        pairs, shape, bend, v, R, t, guides, radius_mm, circle, offsets, functionals, numbers, direction, valid, center,
        mean, level,
    )  # fmt: skip
    levels(numbers, valid, first, edge, told)
    find(numbers, direction, valid, first, edge, moved, REACH * width, told)
    shift = np.empty((n, 2))
    for i in range(n):
        shift[i, 0], shift[i, 1] = told[SHIFT, i], told[SHIFT + 1, i] * v[1] / v[0]
    used = accepted_rims(told[STRENGTH], told[COVERED], told[RADIUS], shift, width, math.nan)
    seen = int(np.sum(used))
    if seen < LEAST_TUBES:
        return seen, math.nan
    shift *= 1.0 - overshot
    return seen, _follow(v, R, t, guides, shift, used, turn, translation)


@compiled
def _follow(
    v: Array, R: Array, t: Array, guides: Array, shift: Array, used: NDArray[np.bool_], turn: Array, translation: Array
) -> float:
    """The pose that shifts the used tubes so, by Tukey's biweight, into `turn` and `translation`.

    Gives how far it shifts all of them, rms px.
    """
    n = guides.shape[0]
    px, J, place = np.empty((n, 2)), np.empty((n, 2, POSE)), np.empty((n, 2, 3))
    middle = np.zeros(2)
    for i in range(n):
        middle += guides[i] / n
    pivot = R[:, 0] * middle[0] + R[:, 1] * middle[1] + t
    linearise(v, 1.0, 1.0, R, t, pivot, guides, POSE, px, J, place)
    A, b, x, squares, seen = np.empty((POSE, POSE)), np.empty(POSE), np.zeros(POSE), np.empty(n), np.empty(n)
    weight, columns, information = used.astype(np.float64), np.arange(POSE), np.ones((n, 3))
    information[:, 1] = 0.0
    for step in range(REWEIGHTS):
        normal_equations(px + shift, px, J, information, weight, columns, A, b)
        x = damped_step(A, b, 0.0)
        if step == REWEIGHTS - 1:
            break
        _left(J, x, shift, squares)
        m = 0
        for i in range(n):
            if used[i]:
                seen[m] = squares[i]
                m += 1
            else:
                squares[i] = np.inf
        weigh(squares, median_in_place(seen, m) / MEDIAN_OF_TWO + LEAST_STRAY_PX * LEAST_STRAY_PX, weight)
    turn[:] = turned(R, x[:3])
    translation[:] = (turn @ R.T) @ (t - pivot) + pivot + x[3:6]
    _left(J, x, np.zeros((n, 2)), squares)
    return math.sqrt(np.mean(squares))


@compiled
def _left(J: Array, x: Array, shift: Array, squares: Array) -> None:
    """Square of what a step leaves of each shift."""
    for i in range(shift.shape[0]):
        squares[i] = 0.0
        for k in range(2):
            off = shift[i, k]
            for p in range(POSE):
                off -= J[i, k, p] * x[p]
            squares[i] += off * off
