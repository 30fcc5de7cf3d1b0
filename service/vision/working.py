"""A camera to track with, where the camera is not known: the same from picture to picture.

One picture tells focal length, principal point and pose apart badly. A camera estimated anew on each wanders, and the
sheet would seem to move with it. Where a tube is seen hardly depends on that, so any that fits serves to follow it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from service.vision.pose import NO_PRIOR, fit_pose, prior_of

if TYPE_CHECKING:
    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.pose import Fit, Prior
    from service.vision.refinement import Refined

__all__ = ["CERTAIN", "WorkingCamera", "usual_focal_length_mm"]

CERTAIN = 0.3
"""A picture that knows its focal length to this part is believed; else it is taken for USUAL picture widths."""
USUAL = 2.0
BETTER = 0.5
"""To what part of its uncertainty another picture must know it for the camera to change."""
ENOUGH = 0.01
"""A picture that knows it to this part is not bettered."""


def usual_focal_length_mm(camera: Camera) -> float:
    """What to take for a focal length of which nothing is known."""
    return USUAL * camera.image_size_px[0] * camera.pixel_pitch_mm[0]


@dataclass(frozen=True, slots=True)
class WorkingCamera:
    """The camera itself where it is complete; else one that completes it.

    Attributes
    ----------
    known
        The full frame's camera, as far as it is known.
    camera
        What to go on with; `known` until a picture has told more.
    uncertainty
        Of its focal length, as a part of it, where that had to be found.
    """

    known: Camera
    lattice: Lattice
    camera: Camera
    uncertainty: float = math.inf

    @property
    def certain(self) -> bool:
        """Whether the camera is known so well that each picture finds the same one."""
        return self.known.complete and self.known.sigma("focal_length_mm") <= ENOUGH * (self.known.focal_length_mm or 1)

    @classmethod
    def of(cls, known: Camera, lattice: Lattice) -> WorkingCamera:
        """With nothing but what is known."""
        return cls(known, lattice, known)

    def learned(self, refined: Refined) -> WorkingCamera:
        """The camera that a picture tells of, where that knows so much more; else the same."""
        if self.known.complete:
            return self
        fit = refined.fit
        uncertainty = max(fit.sigma("focal_length_mm") / (fit.camera.focal_length_mm or 1.0), ENOUGH)
        if uncertainty > BETTER * self.uncertainty:
            return self
        found = fit.camera.of_frame(self.known, refined.parity)
        if uncertainty > CERTAIN:
            found = self._usual(found)
        open_lens = replace(found, lens=None, parameters=(), covariance=np.eye(0))
        bend = NO_PRIOR if self.known.lens else prior_of(open_lens, lens=found.lens)
        camera = self._fit(refined, found, bend).camera.of_frame(self.known, refined.parity)
        return replace(self, camera=camera, uncertainty=uncertainty)

    def pose(self, refined: Refined) -> Fit:
        """The pose of a picture under this camera."""
        return refined.fit if self.certain else self._fit(refined, self.camera, NO_PRIOR)

    def _usual(self, found: Camera) -> Camera:
        """A picture's camera with a usual focal length."""
        known = self.known
        return replace(
            found,
            focal_length_mm=known.focal_length_mm or usual_focal_length_mm(known),
            principal_point_px=known.principal_point_px or known.middle_px,
            sx=known.sx or 1.0,
        )

    def _fit(self, refined: Refined, camera: Camera, prior: Prior) -> Fit:
        fit, used = refined.fit, refined.used
        nearer = (camera.focal_length_mm or 1.0) / (fit.camera.focal_length_mm or 1.0)
        # of what is seen: the lattice's origin may be far aside, and behind the camera
        closer_mm = (nearer - 1.0) * fit.pivot_mm * [0.0, 0.0, 1.0]
        return fit_pose(
            refined.sites.sheet_mm[used], refined.rims.center_px[used], refined.rims.covariance_px[used],
            camera if refined.parity is None else camera.of_field(refined.parity), fit.rotation,
            fit.translation_mm + closer_mm, self.lattice, prior,
        )  # fmt: skip
