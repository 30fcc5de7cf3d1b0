"""Find how far the sheet has moved across the view, when it moved too far for its edges to be followed."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled
from service.vision.pose import linearise
from service.vision.sites import sites_in_picture

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["search_shift"]

TUBES = 32
STEPS = 6
"""Steps to each side: half a pitch, beyond which the neighbouring tube answers as well."""
REACH = 1.15
"""How far that is at the most, in half pitches: the corners of a lattice cell, not those of the square of steps."""
POINTS = 12
"""Points inside and outside of a rim that are compared."""


def search_shift(
    image: Image, vector: Array, rotation: Array, translation_mm: Array, lattice: Lattice
) -> NDArray[np.float64]:
    """Translation, (3,) mm, that brings bores onto dark and the plate about them onto bright.

    Sums the contrast between bore and surroundings of some tubes over a grid of shifts in the sheet's plane of up to
    half a pitch. Each tube's contrast is limited, so that one glare does not decide.
    """
    size = image.shape[1], image.shape[0]
    sites = sites_in_picture(vector, rotation, translation_mm, lattice, size, 0.0)
    if len(sites) < 4:
        return translation_mm
    chosen = sites.sheet_mm[np.linspace(0, len(sites) - 1, min(TUBES, len(sites))).astype(np.int64)]
    n = len(chosen)
    center, J, place = np.empty((n, 2)), np.empty((n, 2, 6)), np.empty((n, 2, 3))
    linearise(vector, 1.0, 1.0, rotation, translation_mm, translation_mm, chosen, 6, center, J, place)
    step = lattice.pitch_mm / 2 / STEPS
    angle = 2 * np.pi * np.arange(POINTS) / POINTS
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    inside = circle * (lattice.rim_radius_mm * np.where(np.arange(POINTS) % 2, 0.75, 0.35))[:, None]
    outside = circle * (0.5 * (lattice.rim_radius_mm + 0.5 * lattice.pitch_mm))
    score = np.zeros((2 * STEPS + 1, 2 * STEPS + 1))
    _scores(image, center, place, inside, outside, step, score)
    along = np.arange(-STEPS, STEPS + 1)
    score[np.hypot(along, along[:, None]) > REACH * STEPS] = -np.inf
    i, j = np.unravel_index(int(np.argmax(score)), score.shape)
    shift = np.array([(int(j) - STEPS) * step, (int(i) - STEPS) * step])
    return np.asarray(translation_mm + rotation[:, :2] @ shift, np.float64)


@compiled
def _scores(
    image: Image, center: Array, place: Array, inside: Array, outside: Array, step: float, score: Array
) -> None:
    """Add up every tube's contrast, -1 to 1, at each shift; the projection is linear about each tube."""
    side = score.shape[0]
    for n in range(center.shape[0]):
        for i in range(side):
            for j in range(side):
                sx, sy = (j - side // 2) * step, (i - side // 2) * step
                dark = _level(image, center[n], place[n], inside, sx, sy)
                bright = _level(image, center[n], place[n], outside, sx, sy)
                if dark >= 0.0 and bright >= 0.0:
                    score[i, j] += (bright - dark) / (bright + dark + 1.0)


@compiled
def _level(image: Image, center: Array, place: Array, points: Array, sx: float, sy: float) -> float:
    """Mean grey value of points about a place, -1 where one of them leaves the picture."""
    h, w = image.shape
    total = 0.0
    for k in range(points.shape[0]):
        x, y = points[k, 0] + sx, points[k, 1] + sy
        px = center[0] + place[0, 0] * x + place[0, 1] * y + 0.5
        py = center[1] + place[1, 0] * x + place[1, 1] * y + 0.5
        if not (0.0 <= px < w and 0.0 <= py < h):
            return -1.0
        total += float(image[int(py), int(px)])
    return float(total / points.shape[0])
