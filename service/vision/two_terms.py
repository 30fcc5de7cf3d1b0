"""Wide lenses of which nothing is known: a second radial term, where one does not reach the picture's edges."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.camera import TsaiLens
from service.vision.edges import start_profile
from service.vision.pose import fit_pose, prior_of
from service.vision.refinement import refine
from service.vision.working import CERTAIN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.refinement import Refined
    from service.vision.stopwatch import Stopwatch

    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["with_two_terms"]

WIDE = 0.05
"""Bend of the picture's corner by the first term from which a second one may show."""
MORE = 1.02
"""How many times the tubes must be seen with two terms: a lens of one term loses some."""


def with_two_terms(
    image: Image, known: Camera, refined: Refined, lattice: Lattice, width: float, *, passes: int, watch: Stopwatch,
    parity: int | None,
) -> Refined:  # fmt: skip
    """Measure anew with OpenCV's k1 and k2 where the lens is unknown; as it was, unless more tubes are then seen.

    Parameters
    ----------
    known
        The picture's camera, as far as it is known.
    refined
        The pose with Tsai's one term.
    width
        Width of the edge that is looked for, in rim radii: where one term failed, tubes lie some px aside.
    """
    fit, camera = refined.fit, refined.fit.camera
    focal = camera.focal_length_mm or 1.0
    corner2 = float(np.sum((np.array(known.image_size_px) * known.pixel_pitch_mm / 2) ** 2))
    if known.lens is not None or not isinstance(camera.lens, TsaiLens):
        return refined
    if abs(camera.lens.kappa1_per_mm2) * corner2 < WIDE:
        return refined
    lens, used = camera.lens.two_terms(focal), refined.used
    prior = prior_of(known, focal, lens)
    near = fit_pose(
        refined.sites.sheet_mm[used], refined.rims.center_px[used], refined.rims.covariance_px[used],
        replace(camera, lens=lens), fit.rotation, fit.translation_mm, lattice, prior,
    )  # fmt: skip
    radius_px = lattice.rim_radius_mm * refined.scale
    other = refine(
        image, near.camera, lattice, prior, near.rotation, near.translation_mm, start_profile(width * radius_px),
        passes=passes, watch=watch, parity=parity,
    )  # fmt: skip
    if other is None or other.fit.sigma("focal_length_mm") > CERTAIN * (other.fit.camera.focal_length_mm or 1.0):
        return refined  # OpenCV's terms are in focal lengths
    return other if other.shown > MORE * refined.shown else refined
