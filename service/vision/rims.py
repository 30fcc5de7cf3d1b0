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

from service.vision.compiled import compiled, median_in_place
from service.vision.edges import profile_of
from service.vision.light import light_slopes
from service.vision.projection import project_point
from service.vision.rays import rays_for, sample_rays, straightening
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
from service.vision.rim_search import REACH, find
from service.vision.rim_solver import solve
from service.vision.scratch import borrowed
from service.vision.shapes import shapes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.edges import EdgeProfile
    from service.vision.lattice import Lattice
    from service.vision.scratch import Scratch

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Rims", "accepted", "accepted_rims", "measure_rims", "px_per_mm"]

NOISE_SCALE = 2.0
"""Error of a sample one px long over the grey values' second difference in the bore."""
LEAST_STRENGTH = 3.3
"""Edges weaker than this are noise: bare plate seldom passes, and less often once radius and place must fit too."""
LEAST_RAYS = 0.4


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
        (n,) grey, straightened as in `rays`: height of the edge, level in the bore, level at the rays' outer ends.
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
    with borrowed() as scratch:
        return _measured(image, vector, rotation, translation_mm, sheet_mm, lattice, profile, rays, scratch)


def _measured(
    image: Image, vector: Array, rotation: Array, translation_mm: Array, sheet_mm: Array, lattice: Lattice,
    profile: EdgeProfile, rays: int | None, scratch: Scratch,
) -> Rims:  # fmt: skip
    """The same with memory to work in."""
    n, aspect = len(sheet_mm), float(vector[0] / vector[1])
    scale = px_per_mm(vector, rotation, translation_mm, sheet_mm)
    count = rays or rays_for(2 * math.pi * lattice.rim_radius_mm * scale)
    functionals, shapes = shapes_of(profile, (lattice.outer_radius_mm - lattice.rim_radius_mm) * scale)
    bend = straightening(image)
    seen = sample_rays(
        image, vector, rotation, translation_mm, sheet_mm, lattice.rim_radius_mm, profile,
        bend if profile.learnt else 0.0, functionals, count, scratch,
    )  # fmt: skip
    told = np.zeros((FIGURES, n))
    noise = levels(seen.numbers, seen.valid, shapes.first, shapes.edge, told)
    light = np.zeros((2, n))
    light_slopes(seen.center_px, aspect, told[HEIGHT], told[STRENGTH], lattice.rim_radius_mm * scale, light)
    if profile.learnt:
        view = _aslant(vector, rotation, translation_mm, sheet_mm, seen.center_px, scale)
        solve(seen, shapes, noise * NOISE_SCALE, view, light, told, scratch)
    else:
        reach = REACH * profile.width_px
        find(seen.numbers, seen.direction, seen.valid, shapes.first, shapes.edge, shapes.moved, reach, told)
    center, shift, covariance, uneven = _placed(seen.center_px, aspect, profile.width_px, told, seen.level, light)
    if not profile.learnt:  # a search reaches farther in grey values as they are
        _straighten(bend, told, seen.mean)
    return Rims(
        center_px=center, shift_px=shift, radius_px=told[RADIUS], covariance_px=covariance, gain=told[HEIGHT],
        bore=told[INNER_LEVEL], outside=told[OUTER_LEVEL], strength=told[STRENGTH], rays=told[COVERED], light_px=uneven,
        mean=seen.mean, looked=profile,
    )  # fmt: skip


@compiled
def _straighten(bend: float, told: Array, mean: Array) -> None:
    """Straighten levels, height of the edge and mean profiles, in place."""
    for i in range(told.shape[1]):
        top = told[INNER_LEVEL, i] + told[HEIGHT, i]
        told[INNER_LEVEL, i] += bend * told[INNER_LEVEL, i] ** 2
        told[OUTER_LEVEL, i] += bend * told[OUTER_LEVEL, i] ** 2
        told[HEIGHT, i] = top + bend * top * top - told[INNER_LEVEL, i]
        for j in range(mean.shape[1]):
            mean[i, j] += bend * mean[i, j] ** 2


@compiled
def _placed(
    predicted: Array, aspect: float, width: float, told: Array, level: Array, light: Array
) -> tuple[Array, Array, Array, Array]:
    """Centres, shifts, covariances and what light may shift, in px of the picture; levels, in place, in grey."""
    n = level.shape[0]
    center, shift, covariance, light_px = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 3)), np.empty((n, 2))
    per_axis = (1.0, 1.0 / aspect)
    for i in range(n):
        told[INNER_LEVEL, i] += level[i]
        told[OUTER_LEVEL, i] += level[i]
        for k in range(2):
            light_px[i, k] = light[k, i] * width * per_axis[k]
            shift[i, k] = told[SHIFT + k, i] * per_axis[k]
            center[i, k] = predicted[i, k] + shift[i, k]
        for k in range(3):
            covariance[i, k] = told[COVARIANCE + k, i] / aspect**k
    return center, shift, covariance, light_px


@compiled
def _aslant(v: Array, R: Array, t: Array, sheet_mm: Array, center: Array, scale: float) -> Array:
    """Where the picture shows a rim that lies one mm deeper, (2, n), in what a mm across is long, px of x."""
    n, aspect = sheet_mm.shape[0], v[0] / v[1]
    view = np.zeros((2, n))
    for i in range(n):
        x, y = project_point(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], 1.0)
        if not math.isnan(x) and not math.isnan(center[i, 0]):
            view[0, i], view[1, i] = (x - center[i, 0]) / scale, aspect * (y - center[i, 1]) / scale
    return view


@compiled
def px_per_mm(vector: Array, rotation: Array, translation_mm: Array, sheet_mm: Array) -> float:
    """Scale in the middle of the places, px per mm."""
    x, y = 0.0, 0.0
    for i in range(sheet_mm.shape[0]):
        x += sheet_mm[i, 0]
        y += sheet_mm[i, 1]
    depth = (rotation[2, 0] * x + rotation[2, 1] * y) / sheet_mm.shape[0] + translation_mm[2]
    return float(math.sqrt(vector[0] * vector[1]) / max(depth, 1e-6))


def accepted(rims: Rims, width_px: float, usual_radius_px: float | None = None) -> NDArray[np.bool_]:
    """Tubes whose edge is clear, whole enough, of the usual size (that of the others) and where it may be."""
    usual = math.nan if usual_radius_px is None else usual_radius_px
    return accepted_rims(rims.strength, rims.rays, rims.radius_px, rims.shift_px, width_px, usual)


@compiled
def accepted_rims(
    strength: Array, rays: Array, radius: Array, shift: Array, width: float, usual: float
) -> NDArray[np.bool_]:
    """Kernel of `accepted`; `usual` is NaN where the tubes themselves tell the usual radius."""
    n = strength.shape[0]
    out, work, m = np.zeros(n, np.bool_), np.empty(n), 0
    for i in range(n):
        if strength[i] > LEAST_STRENGTH and rays[i] > LEAST_RAYS:
            work[m] = radius[i]
            out[i], m = True, m + 1
    if m and math.isnan(usual):
        usual = median_in_place(work, m)
    for i in range(n):
        off = shift[i, 0] * shift[i, 0] + shift[i, 1] * shift[i, 1]
        out[i] = out[i] and abs(radius[i] - usual) < width and off < 4.0 * width * width
    return out
