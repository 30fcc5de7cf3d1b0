"""What a refined pose says to users: tubes and pose, each with its sigma."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.measurement import Origin, Pose, PoseSigma, Tubes
from service.vision.pose import PARAMETERS, linearise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.refinement import Refined

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["pose_of", "tubes_of"]


def pose_of(refined: Refined, lattice: Lattice, camera: Camera, parity: int | None) -> Pose:
    """The pose and its sigmas.

    Parameters
    ----------
    camera
        The full frame's camera, as far as it is known.
    parity
        0 or 1 where the picture was the top or the bottom field, None for a frame.
    """
    fit = refined.fit
    n = 6
    cov = fit.covariance[:n, :n] + _bias_covariance(refined)
    R, t, p = fit.rotation, fit.translation_mm, fit.pivot_mm
    to_origin = np.eye(n)
    to_origin[3:, :3] = -_cross(t - p)  # a turn about the pivot moves the origin: w x (t - p)
    about_origin = to_origin @ cov @ to_origin.T
    used = refined.used
    residual = fit.residual_px[fit.weight > 0]
    error = math.sqrt(float(np.mean(residual**2))) if used.any() else 0.0
    return Pose(
        rotation=R,
        translation_mm=t,
        camera=fit.camera.of_frame(camera, parity),
        covariance=about_origin,
        sigma=_sigma(refined, lattice, cov),
        reprojection_error_px=error,
    )


def _cross(v: Array) -> Array:
    """Matrix of ``v x``."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _bias_covariance(refined: Refined) -> Array:
    """What remains unknown of the light's common shift, as a shift of the pose.

    An apparent depth of all rims is a shift along the sheet's normal; a common shift in the picture one across the
    view.
    """
    fit = refined.fit
    v = fit.camera.vector()
    across = fit.pivot_mm[2]
    J = np.zeros((6, 3))
    J[3, 0], J[4, 1] = across / v[0], across / v[1]
    J[3:, 2] = fit.rotation[:, 2]
    return np.asarray(J @ refined.bias.covariance[:3, :3] @ J.T, np.float64)


def _sigma(refined: Refined, lattice: Lattice, cov: Array) -> PoseSigma:
    fit = refined.fit
    R, t, p = fit.rotation, fit.translation_mm, fit.pivot_mm
    normal = R[:, 2]
    distance = float(normal @ t)
    along = np.concatenate([np.cross(normal, p), normal])
    depth = np.concatenate([-_cross(t - p)[2], [0.0, 0.0, 1.0]])
    slope = -_cross(normal)[:2] @ cov[:3, :3] @ -_cross(normal)[:2].T  # of the normal's x and y
    tilt = math.hypot(normal[0], normal[1])
    eigen = np.linalg.eigvalsh(slope)
    if tilt**2 > 4 * eigen[-1]:
        direction = normal[:2] / tilt
        tilt_variance = float(direction @ slope @ direction)
    else:  # too near to parallel for the tilt to have a direction
        tilt_variance = float(eigen.sum()) / 2
    axis = np.array([0.0, 0.0, distance / max(normal[2], 1e-6)])
    at_axis = np.hstack([-_cross(axis - p), np.eye(3)])[:2] @ cov @ np.hstack([-_cross(axis - p), np.eye(3)])[:2].T
    scale = float(np.median(np.linalg.norm(refined.place[:, 0, :2], axis=1)))
    of_tube = float(np.median(_posterior(refined, lattice)[1][refined.used])) / scale
    pitch = distance * lattice.pitch_sigma_mm / lattice.pitch_mm
    k = 6 + fit.names.index("focal_length_mm") if "focal_length_mm" in fit.names else None
    return PoseSigma(
        tz_mm=math.hypot(math.sqrt(float(depth @ cov @ depth)), pitch),
        distance_mm=math.hypot(math.sqrt(float(along @ cov @ along)), pitch),
        tilt_deg=math.degrees(math.sqrt(tilt_variance)),
        lateral_mm=math.sqrt(float(np.trace(at_axis)) / 2 + of_tube**2),
        focal_length_mm=0.0 if k is None else math.sqrt(float(fit.covariance[k, k])),
    )


def tubes_of(refined: Refined, lattice: Lattice, parity: int | None) -> Tubes:
    """Every place in the picture: measured tubes where they are, the others where the lattice says.

    A measured centre is the weighted mean of what its own rim says and of where the others put it: real tube ends
    scatter by little, so a weak edge counts for little.
    """
    center, sigma = _posterior(refined, lattice)
    if parity is not None:
        center = center * [1.0, 2.0] + [0.0, parity]
        sigma = sigma * math.sqrt(2.5)  # per axis of the full frame: rms of 1 and 2
    return Tubes(
        row=refined.sites.row.astype(np.int32),
        column=refined.sites.column.astype(np.int32),
        center_px=center,
        sigma_px=sigma,
        origin=np.where(refined.used, Origin.MEASURED, Origin.INFERRED).astype(np.uint8),
        state=refined.state,
    )


def _posterior(refined: Refined, lattice: Lattice) -> tuple[Array, Array]:
    """Centres, (n, 2) px, and one sigma per axis, (n,)."""
    fit, n = refined.fit, len(refined.sites)
    camera, columns = fit.camera, 16 if fit.names else 6
    px, J, place = np.empty((n, 2)), np.empty((n, 2, columns)), np.empty((n, 2, 3))
    f, sx = camera.focal_length_mm or 1.0, camera.sx or 1.0
    linearise(
        camera.vector(), f, sx, fit.rotation, fit.translation_mm, fit.pivot_mm, refined.sites.sheet_mm, columns, px, J,
        place,
    )  # fmt: skip
    J = J[:, :, [*range(6), *(6 + PARAMETERS.index(name) for name in fit.names)]]
    predicted = np.einsum("nij,jk,nlk->nil", J, fit.covariance, J)
    center, sigma = px.copy(), np.sqrt((predicted[:, 0, 0] + predicted[:, 1, 1]) / 2)
    u, f2 = refined.used, refined.scatter_factor**2
    S = place[u, :, :2] @ place[u, :, :2].transpose(0, 2, 1) * (f2 * lattice.scatter_mm**2)
    S += place[u, :, 2:] @ place[u, :, 2:].transpose(0, 2, 1) * (f2 * lattice.height_scatter_mm**2)
    xx, xy, yy = refined.rims.covariance_px[u].T
    C = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    gain = S @ np.linalg.inv(S + C)
    center[u] += np.einsum("nij,nj->ni", gain, refined.center_px[u] - px[u])
    rest = np.eye(2) - gain
    covariance = gain @ C + rest @ predicted[u] @ rest.transpose(0, 2, 1)
    sigma[u] = np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2 + refined.misfit.variance_px2[u])
    sigma = np.sqrt(sigma**2 + refined.bias.variance_px2(place))
    return center, sigma
