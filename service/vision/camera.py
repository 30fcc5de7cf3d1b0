"""The camera: pinhole, pixel grid and either of two lens models."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["OPENCV", "TSAI", "Camera", "OpenCVLens", "TsaiLens", "lens_vector"]

TSAI, OPENCV = 0.0, 1.0
UNBOUNDED = 1e9


@dataclass(frozen=True, slots=True)
class TsaiLens:
    """Tsai's one radial term, on the sensor: ``undistorted = distorted * (1 + kappa1 * r_d**2)``, per mm^2."""

    kappa1_per_mm2: float = 0.0

    def two_terms(self, focal_length_mm: float) -> OpenCVLens:
        """OpenCV's k1 and k2 of about the same lens: Tsai's equation turned about, to the second order."""
        k = self.kappa1_per_mm2 * focal_length_mm**2
        return OpenCVLens((-k, 3 * k * k, 0.0, 0.0, 0.0))


@dataclass(frozen=True, slots=True)
class OpenCVLens:
    """OpenCV's k1, k2, p1, p2, k3, on normalised coordinates: ``distorted = undistorted * (1 + k1 r_u**2 + ...)``."""

    coefficients: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """What is known of a camera; None stands for what is not.

    Attributes
    ----------
    image_size_px
        Width and height of the pictures it belongs to.
    pixel_pitch_mm
        (dx, dy) on the sensor.
    focal_length_mm, lens, principal_point_px
        As in a camera file.
    sx
        Willson's horizontal scale: ``Xf = sx * Xd / dx + Cx``. None: not known, near 1.
    name
        What people call it.
    parameters, covariance
        Names out of focal_length_mm, kappa1_per_mm2, k1, k2, p1, p2, k3, cx_px, cy_px, sx, and their (n, n)
        covariance. A known value that is not among them counts as exact.
    """

    image_size_px: tuple[int, int]
    pixel_pitch_mm: tuple[float, float]
    focal_length_mm: float | None = None
    lens: TsaiLens | OpenCVLens | None = None
    principal_point_px: tuple[float, float] | None = None
    sx: float | None = 1.0
    name: str = ""
    parameters: tuple[str, ...] = ()
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def complete(self) -> bool:
        """Whether nothing is left to be estimated."""
        return None not in (self.focal_length_mm, self.lens, self.principal_point_px, self.sx)

    def sigma(self, parameter: str) -> float:
        """One sigma of a parameter; 0 where it counts as exact, or is not known at all."""
        if parameter not in self.parameters:
            return 0.0
        i = self.parameters.index(parameter)
        return math.sqrt(float(self.covariance[i, i]))

    @property
    def middle_px(self) -> tuple[float, float]:
        """The picture's middle, where an unknown principal point starts."""
        return (self.image_size_px[0] - 1) / 2, (self.image_size_px[1] - 1) / 2

    def vector(self) -> NDArray[np.float64]:
        """Intrinsics as kernels take them, see `lens_vector`, not to be written to; unknown values at their start."""
        return _vector_of(self)

    def of_field(self, parity: int) -> Camera:
        """The camera of one field of its interlaced picture: every other line from `parity` (0 top, 1 bottom) on.

        A field is a picture of its own with twice the line pitch; nothing else changes.
        """
        return _field_of(self, parity)

    def with_focal_length(self, focal_length_mm: float, sigma_mm: float) -> Camera:
        """The camera with another prior of its focal length, which has nothing to do with what else is known."""
        keep = [i for i, name in enumerate(self.parameters) if name != "focal_length_mm"]
        covariance = np.zeros((len(keep) + 1, len(keep) + 1))
        covariance[0, 0] = sigma_mm**2
        covariance[1:, 1:] = self.covariance[np.ix_(keep, keep)]
        names = ("focal_length_mm", *(self.parameters[i] for i in keep))
        return replace(self, focal_length_mm=focal_length_mm, parameters=names, covariance=covariance)

    def of_frame(self, known: Camera, parity: int | None) -> Camera:
        """What was found of a picture's camera, in terms of the full frame whose camera is `known`; see `of_field`."""
        if self is known:
            return known
        point = self.principal_point_px
        if parity is not None and point is not None:
            point = point[0], 2 * point[1] + parity
        return replace(
            known, focal_length_mm=self.focal_length_mm, lens=self.lens, sx=self.sx, principal_point_px=point
        )


@lru_cache(maxsize=64)
def _vector_of(camera: Camera) -> NDArray[np.float64]:
    """Kernels ask for it many times a picture."""
    if camera.focal_length_mm is None:
        raise ValueError("a camera without focal length cannot project")
    f, (dx, dy) = camera.focal_length_mm, camera.pixel_pitch_mm
    center = camera.principal_point_px or camera.middle_px
    return lens_vector((camera.sx or 1.0) * f / dx, f / dy, center, camera.lens, f)


@lru_cache(maxsize=64)
def _field_of(camera: Camera, parity: int) -> Camera:
    """The same camera for the same field, again and again."""
    (w, h), (dx, dy), point = camera.image_size_px, camera.pixel_pitch_mm, camera.principal_point_px
    halves = np.array([0.5 if p == "cy_px" else 1.0 for p in camera.parameters])
    return replace(
        camera,
        image_size_px=(w, (h - parity + 1) // 2),
        pixel_pitch_mm=(dx, 2 * dy),
        principal_point_px=None if point is None else (point[0], (point[1] - parity) / 2),
        covariance=camera.covariance * np.outer(halves, halves),
    )


def lens_vector(
    fx: float, fy: float, center_px: tuple[float, float], lens: TsaiLens | OpenCVLens | None, focal_length_mm: float
) -> NDArray[np.float64]:
    """Intrinsics as one array, (11,): fx, fy, cx, cy px, lens kind, five coefficients, largest valid r_u**2.

    Both lens kinds act on normalised coordinates; Tsai's coefficient is ``kappa1 * f**2``. Beyond the largest valid
    undistorted radius the model folds back into the picture and has no answer.
    """
    if isinstance(lens, OpenCVLens):
        k1, k2, _, _, k3 = lens.coefficients
        return np.array([fx, fy, *center_px, OPENCV, *lens.coefficients, _first_fold(k1, k2, k3)])
    k = (lens.kappa1_per_mm2 if lens else 0.0) * focal_length_mm**2
    fold = 4 / (27 * -k) if k < 0 else UNBOUNDED  # r_u of r_d = 1/sqrt(-3k), squared
    return np.array([fx, fy, *center_px, TSAI, k, 0.0, 0.0, 0.0, 0.0, fold])


@lru_cache(maxsize=256)
def _first_fold(k1: float, k2: float, k3: float) -> float:
    """Smallest q = r_u**2 where d r_d / d r_u = 1 + 3 k1 q + 5 k2 q**2 + 7 k3 q**3 vanishes."""
    roots = np.roots(np.trim_zeros(np.array([7 * k3, 5 * k2, 3 * k1, 1.0]), "f"))
    folds = [r.real for r in roots if abs(r.imag) < 1e-12 * max(1.0, abs(r)) and r.real > 0]
    return min(folds, default=UNBOUNDED) if not math.isnan(k1 + k2 + k3) else 0.0
