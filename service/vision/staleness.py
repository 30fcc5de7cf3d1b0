"""Notice from the pictures alone that zoom or focus have changed since the camera was calibrated.

Now and then the pose is solved once more with focal length and lens set free. A tilted sheet tells the focal length by
its perspective, and any sheet the lens's bend. Nearly frontal pictures tell no zoom from a change of distance: then
only the lens itself can.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from service.vision.camera import OpenCVLens
from service.vision.pose import PARAMETERS, Prior, fit_pose

if TYPE_CHECKING:
    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.pose import Fit
    from service.vision.refinement import Refined

__all__ = ["CalibrationWatch"]

EVERY = 11
"""So many pictures in which the calibration is held against one; odd, so that both fields have their turn."""
ENOUGH = 3
"""So many contradictions, less those pictures that agree, make the calibration stale."""
CLEAR = 4.0
"""Sigmas from which a picture contradicts."""
AGREES = 3.0
FOCAL = 0.01
BEND_PX = 0.5
"""Part of the focal length, and bend at the picture's edge, that light may feign and that do no great harm."""
STRETCH = 1e-3
"""What light and lens may stretch the picture: it passes for another focal length where the tilt is small."""


class CalibrationWatch:
    """Holds pictures against a camera that counts as known.

    Parameters
    ----------
    camera
        The full frame's camera.
    """

    def __init__(self, camera: Camera, lattice: Lattice) -> None:
        self._camera, self._lattice = camera, lattice
        self._pictures = self._against = 0
        self.stale = False
        """Whether pictures have contradicted the calibration, and none has agreed with it since."""

    def look(self, refined: Refined) -> bool:
        """Take a measured picture; whether the calibration is stale."""
        self._pictures += 1
        if self._camera.complete and self._pictures % EVERY == 0:
            self._hold_against(refined)
        return self.stale

    def _hold_against(self, refined: Refined) -> None:
        camera = self._camera if refined.parity is None else self._camera.of_field(refined.parity)
        prior = _set_free(camera)
        fit, used = refined.fit, refined.used
        free = fit_pose(
            refined.sites.sheet_mm[used], refined.rims.center_px[used], refined.rims.covariance_px[used],
            replace(camera, focal_length_mm=fit.camera.focal_length_mm), fit.rotation, fit.translation_mm,
            self._lattice, prior, iterations=3,
        )  # fmt: skip
        said = [_off(camera, free, name) for name in ("focal_length_mm", _bend(camera))]
        if any(off > max(CLEAR * sigma, least) for off, sigma, least in said):
            self._against = min(self._against + 1, ENOUGH)
        elif all(off < max(AGREES * sigma, least) for off, sigma, least in said) and said[0][1] < 2 * said[0][2]:
            self._against = max(self._against - 1, 0)
        self.stale = self._against == ENOUGH or (self.stale and self._against > 0)


def _bend(camera: Camera) -> str:
    """The lens's parameter that a picture is asked for."""
    return "k1" if isinstance(camera.lens, OpenCVLens) else "kappa1_per_mm2"


def _set_free(camera: Camera) -> Prior:
    """Priors that leave focal length and bend to the picture, and the rest to what it may be beside the calibration."""
    f, width = camera.focal_length_mm or 1.0, camera.image_size_px[0]
    bend = 0.3 / (0.5 * width * camera.pixel_pitch_mm[0]) ** 2
    sigma = {
        "focal_length_mm": f,
        "sx": math.hypot(STRETCH, camera.sigma("sx")),
        "cx_px": math.hypot(0.01 * width, camera.sigma("cx_px")),
        "cy_px": math.hypot(0.01 * width, camera.sigma("cy_px")),
        "kappa1_per_mm2": bend,
        "k1": bend * f * f,
    }
    names = tuple(n for n in PARAMETERS if n in ("focal_length_mm", "sx", "cx_px", "cy_px", _bend(camera)))
    mean = np.array([_value(camera, n) for n in names])
    return Prior(names, mean, np.diag([sigma[n] ** 2 for n in names]))


def _off(camera: Camera, free: Fit, name: str) -> tuple[float, float, float]:
    """How far a picture puts a parameter off, the sigma of that, and what does no harm, all in its own unit."""
    known, least = _value(camera, name), FOCAL * (camera.focal_length_mm or 1.0)
    if name != "focal_length_mm":
        edge_mm = 0.5 * camera.image_size_px[0] * camera.pixel_pitch_mm[0]
        least = BEND_PX * camera.pixel_pitch_mm[0] / edge_mm**3
        least *= (camera.focal_length_mm or 1.0) ** 2 if name == "k1" else 1.0
    return abs(_value(free.camera, name) - known), math.hypot(free.sigma(name), camera.sigma(name)), least


def _value(camera: Camera, name: str) -> float:
    x, y = camera.principal_point_px or camera.middle_px
    if name == "k1":
        return camera.lens.coefficients[0] if isinstance(camera.lens, OpenCVLens) else 0.0
    bend = 0.0 if camera.lens is None or isinstance(camera.lens, OpenCVLens) else camera.lens.kappa1_per_mm2
    return {
        "focal_length_mm": camera.focal_length_mm or 0.0,
        "sx": camera.sx or 1.0,
        "cx_px": x,
        "cy_px": y,
        "kappa1_per_mm2": bend,
    }[name]
