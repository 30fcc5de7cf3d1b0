"""A camera from pictures of the sheet itself: the tube lattice stands in the place of a calibration chart."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.bundle import COMMON, POSE, Bundle, Range, Solution, State
from service.vision.bundle_solver import solve
from service.vision.camera import Camera, OpenCVLens, TsaiLens
from service.vision.errors import DegenerateError
from service.vision.pose import NO_PRIOR, Prior, camera_with, fit_pose, prior_of
from service.vision.working import CERTAIN, usual_focal_length_mm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from service.vision.keyframes import Keyframe
    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Calibration", "calibrate", "starting_camera", "starting_state"]

CLEARLY = 25.0
"""By so much must chi-square fall for OpenCV's two radial terms to be taken instead of Tsai's one."""
LEAST_TUBES = 12
BLIND = 5.0
"""How many times the focal length's sigma grows where pictures are measured with a camera that is not known yet."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What the pictures say of the camera.

    Attributes
    ----------
    camera
        With everything that is known of it, and its covariance.
    solution
        What it rests on.
    """

    camera: Camera
    solution: Solution
    bundle: Bundle

    @property
    def frames(self) -> int:
        """How many pictures it rests on."""
        return self.bundle.frames

    @property
    def reprojection_error_px(self) -> float:
        """RMS per axis of the tubes that were not set aside, about their nominal places."""
        used = self.solution.residual_px[self.solution.spread.weight > 0]
        return math.sqrt(float(np.mean(used**2))) if used.size else 0.0

    def first_answer(self) -> Calibration:
        """The same of pictures that were measured with a camera not yet known, and cannot be measured again."""
        if "focal_length_mm" not in self.camera.parameters:
            return self
        wider = np.array([BLIND if name == "focal_length_mm" else 1.0 for name in self.camera.parameters])
        return replace(self, camera=replace(self.camera, covariance=self.camera.covariance * np.outer(wider, wider)))

    def depth_over_focal(self) -> tuple[float, float]:
        """Depth of the tubes' middle in the first picture by the focal length, and its sigma.

        However little is known of the two, this is: Tsai's Tz/f.
        """
        z, f = float(self.solution.pivot_mm[0, 2]), self.camera.focal_length_mm or 1.0
        gradient = np.zeros(len(self.solution.covariance))
        gradient[5] = 1 / f
        if "focal_length_mm" in self.solution.names:
            gradient[POSE * self.frames + self.solution.names.index("focal_length_mm")] = -z / f**2
        return z / f, math.sqrt(float(gradient @ self.solution.covariance @ gradient))


def calibrate(
    keyframes: Sequence[Keyframe], camera: Camera, lattice: Lattice, known_range: Range | None = None
) -> Calibration:
    """Solve for all that `camera` leaves open or gives with a sigma.

    Raises
    ------
    DegenerateError
        There are no pictures, or they show too few tubes.
    """
    keyframes = [k for k in keyframes if len(k) >= LEAST_TUBES]
    if not keyframes:
        raise DegenerateError(f"no picture shows {LEAST_TUBES} tubes")
    bundle = Bundle.of(keyframes, lattice)
    start = starting_camera(keyframes, camera)
    prior = prior_of(camera, start.focal_length_mm)
    state = starting_state(keyframes, start, lattice)
    solution = solve(bundle, start, prior, state, known_range)
    if camera.lens is None:
        bent, bent_prior, bent_state = _two_terms(start, prior, solution.state)
        other = solve(bundle, bent, bent_prior, bent_state, known_range, solution.spread)
        if other.cost < solution.cost - CLEARLY:
            solution = solve(bundle, bent, bent_prior, other.state, known_range)
            start = bent
    return Calibration(_camera_of(start, solution), solution, bundle)


def starting_camera(keyframes: Sequence[Keyframe], camera: Camera) -> Camera:
    """A complete camera to begin with: what single pictures say, where `camera` says nothing."""
    f = camera.focal_length_mm
    if f is None:
        each = np.array([k.camera.focal_length_mm or 1.0 for k in keyframes])
        relative = np.array([max(k.focal_sigma_mm, 1e-6) for k in keyframes]) / each
        f = math.exp(float(np.average(np.log(each), weights=relative**-2.0)))
        if np.sum(relative**-2.0) < CERTAIN**-2:  # no more than a guess, which would be its own prior
            f = usual_focal_length_mm(camera)
    lens = camera.lens
    if lens is None:
        lens = TsaiLens(float(np.median([_bend(k.camera) for k in keyframes])))
    return replace(
        camera, focal_length_mm=f, lens=lens, sx=camera.sx or 1.0,
        principal_point_px=camera.principal_point_px or camera.middle_px,
    )  # fmt: skip


def _bend(camera: Camera) -> float:
    """Tsai's kappa1 of a complete camera, of an OpenCV lens to the first order."""
    if isinstance(camera.lens, OpenCVLens):
        return -camera.lens.coefficients[0] / (camera.focal_length_mm or 1.0) ** 2
    return camera.lens.kappa1_per_mm2 if camera.lens else 0.0


def starting_state(keyframes: Sequence[Keyframe], camera: Camera, lattice: Lattice) -> State:
    """Each picture's pose under one camera."""
    rotation, translation = [], []
    for k in keyframes:
        nearer = (camera.focal_length_mm or 1.0) / (k.camera.focal_length_mm or 1.0)
        fit = fit_pose(
            k.sheet_mm, k.center_px, k.covariance_px, camera, k.rotation, k.translation_mm * [1.0, 1.0, nearer],
            lattice, NO_PRIOR,
        )  # fmt: skip
        rotation.append(fit.rotation)
        translation.append(fit.translation_mm)
    return State(_values(camera), np.array(rotation), np.array(translation), np.zeros(COMMON))


def _values(camera: Camera) -> Array:
    """PARAMETERS of a complete camera, (10,)."""
    assert camera.focal_length_mm is not None
    assert camera.principal_point_px is not None
    lens = camera.lens
    kappa1 = lens.kappa1_per_mm2 if isinstance(lens, TsaiLens) else 0.0
    opencv = lens.coefficients if isinstance(lens, OpenCVLens) else (0.0,) * 5
    return np.array([camera.focal_length_mm, camera.sx or 1.0, *camera.principal_point_px, kappa1, *opencv])


def _two_terms(camera: Camera, prior: Prior, state: State) -> tuple[Camera, Prior, State]:
    """The same with OpenCV's k1 and k2 in the place of Tsai's kappa1: about the same lens, where that bends little."""
    f, kappa1 = state.values[0], state.values[4]
    k = kappa1 * f * f
    values = state.values.copy()
    values[4:] = 0.0, -k, 3 * k * k, 0.0, 0.0, 0.0
    i = prior.names.index("kappa1_per_mm2")
    wide = prior.covariance[i, i] ** 0.5 * f * f  # bends the picture's edge by a third; the second term as well
    edge2 = 0.3 / wide
    keep = [j for j in range(len(prior.names)) if j != i]
    names = (*(prior.names[j] for j in keep), "k1", "k2")
    mean = np.append(prior.mean[keep], [0.0, 0.0])
    covariance = np.zeros((len(names), len(names)))
    covariance[: len(keep), : len(keep)] = prior.covariance[np.ix_(keep, keep)]
    covariance[-2, -2], covariance[-1, -1] = wide**2, (wide / edge2) ** 2
    bent = replace(camera, lens=OpenCVLens())
    return camera_with(bent, values), Prior(names, mean, covariance), replace(state, values=values)


def _camera_of(start: Camera, solution: Solution) -> Camera:
    camera = camera_with(start, solution.state.values)
    return replace(camera, parameters=solution.names, covariance=solution.camera_covariance.copy())
