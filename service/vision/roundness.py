"""How far tube ends are out of round: a pattern of squares may have the lattice's places, but not its circles."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np

from service.vision.rays import straightening

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice
    from service.vision.refinement import Refined

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["out_of_round"]

TUBES = 64
"""As many tubes are looked at, those with the clearest edges first."""
DIRECTIONS = 24
RADII = np.linspace(0.5, 1.4, 10)
"""Where they are looked at, in apparent radii: a neighbour's bore begins at 1.8."""
WEIGHT = np.array([0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.0])
"""How much so many waves around the rim count: one is a shift or the fall of light, two may be smear or a bore's slant,
six a triangular lattice's own neighbours."""


def out_of_round(image: Image, refined: Refined, lattice: Lattice) -> float:
    """How far the usual tube's outline strays from a circle in the sheet, one sigma, in radii; 0 where none is whole.

    The outline in a direction lies where what is dark along the ray would end if it were black. Noise differs from
    ray to ray, shape does not: what even rays and odd ones say alike is shape.
    """
    rims, used = refined.rims, np.flatnonzero(refined.used)
    order = used[np.argsort(-rims.strength[used], kind="stable")[:TUBES]]
    place = refined.place[order, :, :2]
    scale = float(np.median(np.linalg.norm(place, axis=1)))
    radius_mm = lattice.rim_radius_mm + refined.common.profile.position_px / scale
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    rays_mm = radius_mm * np.outer([np.cos(angle), np.sin(angle)], RADII).reshape(2, -1)
    from_center = place[:, :, :1] * rays_mm[0] + place[:, :, 1:] * rays_mm[1]
    points = (rims.center_px[order, :, None] + from_center).astype(np.float32)
    whole = ((points >= 0) & (points <= np.array(image.shape[::-1])[:, None] - 1)).all(axis=(1, 2))
    if not whole.any():
        return 0.0
    seen = cv2.remap(image, points[whole, 0], points[whole, 1], cv2.INTER_LINEAR).reshape(-1, DIRECTIONS, len(RADII))
    grey = seen + straightening(image) * np.square(seen, dtype=np.float64)
    bore, gain = (level[order][whole][:, None, None] for level in (rims.bore, rims.gain))
    dark = 1 - np.clip((grey - bore) / gain, 0.0, 1.0)
    return _strays(RADII[0] + dark.sum(axis=2) * (RADII[1] - RADII[0]))


def _strays(outline: Array) -> float:
    """Root of what even and odd rays say alike of the outlines' waves, (n, DIRECTIONS); the median outline's."""
    outline = outline / outline.mean(axis=1, keepdims=True)
    half = DIRECTIONS // 2
    even, odd = (np.fft.rfft(outline[:, first::2], axis=1) / half for first in (0, 1))
    turned = odd * np.exp(-2j * np.pi * np.arange(odd.shape[1]) / DIRECTIONS)  # odd rays begin one step on
    alike = 2 * (even * turned.conj()).real @ WEIGHT**2
    return float(max(np.median(alike), 0.0) ** 0.5)
