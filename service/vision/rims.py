"""Measure tube ends along the normals of their projected rims.

A tube end is a circle in the sheet. Its picture under a known pose is sampled along the normals of the *projected
circle*, so there is no ellipse-centre bias; what is left to find is how far the true rim lies from the predicted one:
a shift ``(dx, dy)`` of the tube and, as a nuisance, a change ``dr`` of the apparent radius (weld ring, blur).

All grey values along a tube's rays are explained at once, by the five `shapes`: a level, the picture's own mean edge
profile, what begins beyond the tube's wall, the seam there, and a shift. Each shape's share changes around the rim as
``a + b cos + c sin``: light falls unevenly on bore, tube end and plate, each in its own way, and what is not allowed to
is taken for a shift. The shift's own three are dr, dx and dy. How far the shares stray, around the rim and from ray to
ray, is known beforehand, which makes the solution a linear one with a covariance; rays that do not fit are then
weighed down (hose, glint, speck) and it is solved again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.edges import profile_of
from service.vision.light import SLOPE_REACH, light_slopes
from service.vision.rays import rays_for, sample_rays
from service.vision.rim_levels import (
    COVARIANCE,
    COVERED,
    FIGURES,
    HEIGHT,
    INNER_LEVEL,
    OUTER_LEVEL,
    RADIUS,
    SHIFT,
    STRENGTH,
    levels,
)  # fmt: skip
from service.vision.rim_search import find
from service.vision.rim_solver import solve
from service.vision.shapes import shapes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.edges import EdgeProfile
    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Rims", "measure_rims"]

LIGHT_SHIFT, LIGHT_BLUR, SHARP_PX = 0.15, 1.0, 0.8
"""What uneven light shifts a rim by, in `Rims.light_px`: on sharp pictures, and more per px of blur beyond SHARP_PX.
Measured on truth."""
NOISE_SCALE = 2.0
"""Error of a sample one px long over the grey values' second difference in the bore."""
REACH = 1.6
"""Largest shift of a ray, in edge widths, that the linear model serves."""


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """What the rims at n predicted places showed, in the order asked for.

    Attributes
    ----------
    center_px
        (n, 2) measured centre of each tube-end circle's projection; that predicted, where there is none.
    shift_px
        (n, 2) how far it lies from where it was predicted.
    radius_px
        (n,) change of the apparent radius against the profile's.
    covariance_px
        (n, 3) xx, xy, yy of the centre.
    gain, bore, outside
        (n,) grey: height of the edge, level in the bore, level at the rays' outer ends.
    strength
        (n,) height of the edge over its uncertainty, as the rays tell it; negative where nothing could be measured.
    rays
        (n,) share of the rays that take part.
    light_px
        (n, 2) edge width times the relative change of the light from the tube's centre to its rim: what uneven light
        may shift a rim by.
    mean
        (n, SAMPLES) mean profile of each tube's rays.
    looked
        The edge that placed the samples.
    """

    center_px: NDArray[np.float64]
    shift_px: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    covariance_px: NDArray[np.float64]
    gain: NDArray[np.float64]
    bore: NDArray[np.float64]
    outside: NDArray[np.float64]
    strength: NDArray[np.float64]
    rays: NDArray[np.float64]
    light_px: NDArray[np.float64]
    mean: NDArray[np.float64]
    looked: EdgeProfile

    def profile(self) -> EdgeProfile | None:
        """The mean edge of the clearest tubes; None where too few show one."""
        return profile_of(self.mean, self.bore, self.gain, self.strength, self.rays, self.looked)


def measure_rims(
    image: Image,
    vector: Array,
    rotation: Array,
    translation_mm: Array,
    sheet_mm: Array,
    lattice: Lattice,
    profile: EdgeProfile,
    rays: int | None = None,
) -> Rims:
    """Measure the tubes at `sheet_mm`, (n, 2) nominal places, n >= 1, predicted to within an edge width or two.

    Parameters
    ----------
    image
        (h, w) grey, C-contiguous.
    vector, rotation, translation_mm
        Intrinsics (`camera.lens_vector`) and predicted pose.
    profile
        Where and how wide the edge is expected.
    rays
        Rays a tube, a multiple of four; by default as many as the rim's size deserves.
    """
    n, aspect = len(sheet_mm), float(vector[0] / vector[1])
    scale = _px_per_mm(vector, rotation, translation_mm, sheet_mm)
    count = rays or rays_for(2 * math.pi * lattice.rim_radius_mm * scale)
    functionals, shapes = shapes_of(profile, (lattice.outer_radius_mm - lattice.rim_radius_mm) * scale)
    seen = sample_rays(
        image, vector, rotation, translation_mm, sheet_mm, lattice.rim_radius_mm, profile, functionals, count
    )
    told = np.zeros((FIGURES, n))
    noise = levels(seen.numbers, seen.valid, shapes.first, shapes.edge, told)
    if profile.learnt:
        solve(
            seen.numbers, seen.direction, seen.valid, shapes.first, shapes.information, shapes.basis, shapes.prior,
            shapes.expected, noise * NOISE_SCALE, told,
        )  # fmt: skip
    else:
        reach = REACH * profile.width_px
        find(seen.numbers, seen.direction, seen.valid, shapes.first, shapes.edge, shapes.moved, reach, told)
    slope = np.zeros((n, 2))
    light_slopes(
        seen.center_px, aspect, told[HEIGHT], told[STRENGTH], SLOPE_REACH * lattice.pitch_mm * scale,
        lattice.rim_radius_mm * scale, slope,
    )  # fmt: skip
    light = slope * [profile.width_px, profile.width_px / aspect]
    shift = told[SHIFT : SHIFT + 2].T / [1.0, aspect]
    shift += (LIGHT_SHIFT + LIGHT_BLUR * max(0.0, profile.width_px - SHARP_PX)) * light
    return Rims(
        center_px=seen.center_px + shift, shift_px=shift, radius_px=told[RADIUS],
        covariance_px=told[COVARIANCE : COVARIANCE + 3].T / [1.0, aspect, aspect * aspect], gain=told[HEIGHT],
        bore=told[INNER_LEVEL] + seen.level, outside=told[OUTER_LEVEL] + seen.level, strength=told[STRENGTH],
        rays=told[COVERED], light_px=light, mean=seen.mean, looked=profile,
    )  # fmt: skip


def _px_per_mm(vector: Array, rotation: Array, translation_mm: Array, sheet_mm: Array) -> float:
    """Scale in the middle of the places, px per mm."""
    middle = sheet_mm.mean(axis=0)
    depth = rotation[2, 0] * middle[0] + rotation[2, 1] * middle[1] + translation_mm[2]
    return math.sqrt(vector[0] * vector[1]) / max(float(depth), 1e-6)
