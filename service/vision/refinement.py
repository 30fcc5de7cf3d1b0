"""From a rough pose to the measured one: rims, robust solution, and what the picture's light may shift in common."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_in_place
from service.vision.edges import EdgeProfile, start_profile
from service.vision.pose import Fit, fit_pose, linearise
from service.vision.projection import scale_of
from service.vision.rims import Rims, accepted, measure_rims, px_per_mm
from service.vision.sites import Sites, sites_in_picture
from service.vision.states import tube_states
from service.vision.systematics import Common, edge_bias, lit_walls, smooth_misfit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.pose import Prior
    from service.vision.stopwatch import Stopwatch

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["AT_REST", "WIDEST", "Refined", "projected", "refine"]

LEAST_TUBES = 6
"""Fewer measured tubes do not make a pose worth telling."""
SETTLED, STILL_SETTLED = 0.05, 0.15
"""Edge widths that the tubes may lie off, in the middle of them all, for a pass to be the last; and where the profile
is known from the picture before, so that a shift is all that there is to find."""
AT_REST = 0.25
"""Edge widths that a solution may lie from where rims were looked for, rms: shifts are told a few per cent short."""
RESTLESS = 1.0
"""The same for a solution that is still moving after the last pass: one that swings farther is none."""
STEADY_WIDTH, NEAR_WIDTH = 0.93, 0.75
"""Least part of a profile's width that the next one may have, for a pass to be the last; and for it to be the last on a
few tubes."""
NARROWING = 0.36
"""Most that the search narrows from pass to pass."""
WIDEST = 0.3
"""Width of an edge, of the rim's radius, beyond which rays would reach across the bore to its other side."""
SOFT = 0.15
"""Width of an edge, of the rim's radius, from which lit walls and what lies beyond reach into it by more and more."""
ON_ALL = 2
"""Passes, at the least, on all tubes, where the first are on a few."""
LIKELY_WIDTH_PX = 1.2
"""Width to go on with where no clear edge tells it."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A pose with all that it rests on.

    Attributes
    ----------
    sites
        Places whose rim was looked at, n.
    rims
        What they showed, about the pose before the last solution; covariances hold what lit bore walls may do.
    measured, used
        (n,) whether the tube was measured, and whether it also agrees with its neighbours.
    fit
        The solution.
    predicted_px, place
        (n, 2) and (n, 2, 3): projection under `fit`, and its derivative by the tube's own place, px per mm.
    moved_px
        How far that lies from where rims were looked for, rms.
    scale
        Px per mm in the middle of the places.
    common
        How edges look here, what the light may shift in common, what is smooth in the residuals.
    state
        (n,) uint8 of `TubeState`.
    shape
        The picture's height and width.
    parity
        0 or 1 where the picture was the top or bottom field, None for a frame.
    """

    sites: Sites
    rims: Rims
    measured: NDArray[np.bool_]
    used: NDArray[np.bool_]
    fit: Fit
    predicted_px: NDArray[np.float64]
    place: NDArray[np.float64]
    moved_px: float
    scale: float
    common: Common
    state: NDArray[np.uint8]
    shape: tuple[int, ...]
    parity: int | None

    @property
    def shown(self) -> int:
        """How many tubes are used."""
        return int(np.count_nonzero(self.used))

    @property
    def share(self) -> float:
        """Part of the places that shows a tube which is used."""
        return self.shown / len(self.used)

    def shifted(self, row: int, column: int, lattice: Lattice) -> Refined:
        """The same with every place's index grown by (row, column)."""
        step = lattice.sheet_points(np.array([row]), np.array([column]))[0]
        sites = Sites(self.sites.row + row, self.sites.column + column, self.sites.sheet_mm + step)
        translation = self.fit.translation_mm - self.fit.rotation[:, :2] @ step
        return replace(self, sites=sites, fit=replace(self.fit, translation_mm=translation))


def _likely_centers(rims: Rims) -> Array:
    """Measured centres, (n, 2) px, less what a guessed edge overshoots."""
    return rims.center_px - rims.looked.overshot * rims.shift_px


@compiled
def _moved_px(shift: Array, used: NDArray[np.bool_]) -> float:
    """How far the used tubes, at least one, lie off, in the middle of them all."""
    off, moved = np.empty(shift.shape[0]), 0.0
    for k in range(2):
        n = 0
        for i in range(shift.shape[0]):
            if used[i]:
                off[n] = shift[i, k]
                n += 1
        moved = max(moved, abs(median_in_place(off, n)))
    return moved


def refine(
    image: Image,
    camera: Camera,
    lattice: Lattice,
    prior: Prior,
    rotation: Array,
    translation_mm: Array,
    profile: EdgeProfile,
    *,
    passes: int,
    watch: Stopwatch,
    before: Common | None = None,
    afresh: bool = True,
    parity: int | None = None,
    few: int | None = None,
    at_rest: float = AT_REST,
) -> Refined | None:
    """Measure all tubes in the picture and solve for the pose, until it stands still; None where too few are seen.

    Parameters
    ----------
    image
        (h, w) grey of `camera`: a frame, or one field with its field's camera.
    camera, prior
        Where the camera starts, and what of it is to be estimated.
    rotation, translation_mm
        Rough pose: within a quarter of a rim's radius for a profile that wide.
    passes
        How often to measure at the most. A pass whose tubes lay where they were expected, under a profile as narrow as
        the edges are, is the last.
    before
        What the picture before had in common.
    afresh
        Whether to find that anew, going on from `before`, rather than to take it as it was.
    parity
        0 or 1 where the picture is the top or bottom field, None for a frame: passed through.
    few
        How many tubes, spread over the picture, to measure until the pose hardly moves, before all are; None: all from
        the first pass on.
    at_rest
        Edge widths that the solution may lie from where rims were looked for.
    """
    on_all, least = 0, 1 if few is None else ON_ALL
    for step in range(passes):
        looked = _look(image, camera, lattice, rotation, translation_mm, profile, few)
        watch.lap("detect")
        if looked is None and few is None:
            return None
        if looked is None:
            few = None
            continue
        sites, rims, used = looked
        as_before = before is not None and not afresh
        moved, settled = _moved_px(rims.shift_px, used), SETTLED if before is None else STILL_SETTLED
        narrow = profile
        if not as_before:
            scale = px_per_mm(camera.vector(), rotation, translation_mm, sites.sheet_mm)
            narrow = _narrowed(rims.profile(), profile, moved, WIDEST * lattice.rim_radius_mm * scale)
        steady = moved < settled * profile.width_px and narrow.width_px > STEADY_WIDTH * profile.width_px
        near = moved < STILL_SETTLED * profile.width_px and narrow.width_px > NEAR_WIDTH * profile.width_px
        on_all += few is None
        if step == passes - 1 or (steady and on_all >= least):
            refined = _solved(
                *looked, narrow, image.shape, camera, lattice, prior, rotation, translation_mm, before, afresh, parity
            )
            watch.lap("pose")
            if refined is None or refined.moved_px < at_rest * narrow.width_px:
                return refined
            if step == passes - 1:
                return refined if refined.moved_px < RESTLESS * narrow.width_px else None
            fit, profile = refined.fit, narrow
            camera, rotation, translation_mm = fit.camera, fit.rotation, fit.translation_mm
            continue
        fit = fit_pose(
            sites.sheet_mm[used], _likely_centers(rims)[used], rims.covariance_px[used], camera, rotation,
            translation_mm, lattice, prior,
        )  # fmt: skip
        camera, rotation, translation_mm, profile = fit.camera, fit.rotation, fit.translation_mm, narrow
        few = None if near or step >= passes - 1 - ON_ALL else few
        watch.lap("pose")
    return None


def _look(
    image: Image, camera: Camera, lattice: Lattice, rotation: Array, translation_mm: Array, profile: EdgeProfile,
    few: int | None,
) -> tuple[Sites, Rims, NDArray[np.bool_]] | None:  # fmt: skip
    """Measure the tubes in the picture, or `few` of them; None where too few are seen."""
    vector, size = camera.vector(), (image.shape[1], image.shape[0])
    sites = sites_in_picture(vector, rotation, translation_mm, lattice, size, 0.0)
    if len(sites) < LEAST_TUBES:
        return None
    if few is not None and len(sites) > few:
        sites = sites.take(np.linspace(0, len(sites) - 1, few).astype(np.int64))
    rims = measure_rims(image, vector, rotation, translation_mm, sites.sheet_mm, lattice, profile)
    used = accepted(rims, profile.width_px)
    return None if np.count_nonzero(used) < LEAST_TUBES else (sites, rims, used)


@compiled
def _rms_apart(a: Array, b: Array) -> float:
    """Root mean square distance of points, (n, 2), without those that have no image."""
    squares, n = 0.0, 0
    for i in range(a.shape[0]):
        d = (a[i, 0] - b[i, 0]) ** 2 + (a[i, 1] - b[i, 1]) ** 2
        if d >= 0.0:  # not NaN
            squares += d
            n += 1
    return math.sqrt(squares / max(n, 1))


def _solved(
    sites: Sites, rims: Rims, used: NDArray[np.bool_], profile: EdgeProfile, shape: tuple[int, ...], camera: Camera,
    lattice: Lattice, prior: Prior, rotation: Array, translation_mm: Array, before: Common | None, afresh: bool,
    parity: int | None,
) -> Refined | None:  # fmt: skip
    """The last solution, with what no residual shows of light and lens in its covariance; None where there is none."""
    which = np.flatnonzero(used)
    looked_px, place = projected(camera, rotation, translation_mm, sites.sheet_mm)
    scale = scale_of(place)
    bias = edge_bias(rims.covariance_px[which], scale, profile.width_px)
    soft = max(1.0, profile.blur_px / (SOFT * lattice.rim_radius_mm * scale))
    lit, covariance = lit_walls(rims.gain, rims.bore, rims.covariance_px, place, scale, soft * profile.width_px)
    rims = replace(rims, covariance_px=covariance)
    fit = fit_pose(
        sites.sheet_mm[which], rims.center_px[which], covariance[which], camera, rotation, translation_mm, lattice,
        prior,
    )  # fmt: skip
    if not np.isfinite(fit.covariance).all():  # a pose that the tubes do not determine
        return None
    predicted, place = projected(fit.camera, fit.rotation, fit.translation_mm, sites.sheet_mm)
    if before is None or afresh:
        misfit = smooth_misfit(fit, predicted[which], shape, profile.width_px)
    else:
        misfit = before.misfit
    unseen = np.empty((2, len(which), 2))
    unseen[0], unseen[1] = math.sqrt(bias.covariance[3, 3]) * rims.light_px[which], lit[which]
    fit = fit.widened(unseen, misfit.covariance)
    agreeing = used.copy()
    agreeing[which[fit.weight <= 0.0]] = False
    return Refined(
        sites=sites, rims=rims, measured=used, used=agreeing, fit=fit, predicted_px=predicted, place=place,
        moved_px=_rms_apart(predicted, looked_px), scale=scale, common=Common(profile, bias, misfit),
        state=tube_states(sites, rims, agreeing), shape=shape, parity=parity,
    )  # fmt: skip


def _narrowed(seen: EdgeProfile | None, before: EdgeProfile, moved_px: float, widest_px: float) -> EdgeProfile:
    """The profile for the next pass: narrower in steps only, as the first passes' pose still strays."""
    if seen is not None and seen.width_px > widest_px:
        seen = seen.narrowed(widest_px)
    least = max(NARROWING * before.width_px, min(moved_px, before.width_px))
    if seen is None:
        return start_profile(max(least, min(before.width_px, LIKELY_WIDTH_PX)), before.position_px)
    return seen if seen.width_px >= least else start_profile(least, seen.position_px)


def projected(camera: Camera, rotation: Array, translation_mm: Array, sheet_mm: Array) -> tuple[Array, Array]:
    """Picture points, (n, 2) px, and their derivative by the point's own place, (n, 2, 3) px per mm."""
    n = len(sheet_mm)
    px, J, place = np.empty((n, 2)), np.empty((n, 2, 6)), np.empty((n, 2, 3))
    linearise(camera.vector(), 1.0, 1.0, rotation, translation_mm, translation_mm, sheet_mm, 6, px, J, place)
    return px, place
