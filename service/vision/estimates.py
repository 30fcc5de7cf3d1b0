"""What a refined pose says to users: tubes and pose, each with its sigma."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_of
from service.vision.measurement import Origin, Pose, PoseSigma, Tubes
from service.vision.pose import PARAMETERS, linearise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.refinement import Refined

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["estimates"]

TELLING_PX, TELLING_SCATTERS = 0.3, 2.0
"""A rim tells its tube's place where its own sigma is below so many px, or below so many times the tubes' scatter;
elsewhere the others tell it as well, and better than a stain that was taken for a rim."""


def estimates(refined: Refined, lattice: Lattice, camera: Camera, parity: int | None) -> tuple[Pose, Tubes]:
    """The pose and every place in the picture, with their sigmas.

    A measured tube's centre is the weighted mean of what its own rim says and of where the others put it: real tube
    ends scatter by little, so a weak edge counts for little. One that counts for next to nothing does not make a tube a
    measured one: it is told as inferred, where the pose puts its nominal place.

    Parameters
    ----------
    camera
        The full frame's camera, as far as it is known.
    parity
        0 or 1 where the picture was the top or the bottom field, None for a frame.
    """
    scale = median_of(np.hypot(refined.place[:, 0, 0], refined.place[:, 0, 1]))
    measured = _telling(refined, lattice, scale)
    center, sigma = _posterior(refined, lattice, measured)
    usual = median_of(sigma[measured if measured.any() else refined.used])
    pose = _pose(refined, lattice, camera, parity, usual / scale)
    if parity is not None:
        center = center * [1.0, 2.0] + [0.0, parity]
        sigma = sigma * math.sqrt(2.5)  # per axis of the full frame: rms of 1 and 2
    tubes = Tubes(
        row=refined.sites.row.astype(np.int32),
        column=refined.sites.column.astype(np.int32),
        center_px=center,
        sigma_px=sigma,
        origin=np.where(measured, Origin.MEASURED, Origin.INFERRED).astype(np.uint8),
        state=refined.state,
    )
    there = np.isfinite(center[:, 0])  # the last solution may have moved a place beyond a bent lens's fold
    return pose, tubes if there.all() else tubes.take(there)


def _pose(refined: Refined, lattice: Lattice, camera: Camera, parity: int | None, tube_sigma_mm: float) -> Pose:
    fit = refined.fit
    R, t = fit.rotation, fit.translation_mm
    out = np.empty(4)
    covariance = _pose_sigmas(
        fit.covariance, refined.common.bias.covariance, R, t, fit.pivot_mm, fit.camera.vector(), out
    )
    distance = float(R[:, 2] @ t)
    pitch = distance * lattice.pitch_sigma_mm / lattice.pitch_mm
    k = 6 + fit.names.index("focal_length_mm") if "focal_length_mm" in fit.names else None
    residual = fit.residual_px[fit.weight > 0]
    return Pose(
        rotation=R,
        translation_mm=t,
        camera=fit.camera.of_frame(camera, parity),
        covariance=covariance,
        sigma=PoseSigma(
            tz_mm=math.hypot(out[0], pitch),
            distance_mm=math.hypot(out[1], pitch),
            tilt_deg=math.degrees(out[2]),
            lateral_mm=max(float(out[3]), tube_sigma_mm),  # a tube's own sigma holds the pose's
            focal_length_mm=0.0 if k is None else math.sqrt(float(fit.covariance[k, k])),
        ),
        reprojection_error_px=math.sqrt(float(np.mean(residual**2))) if residual.size else 0.0,
    )


@compiled
def _pose_sigmas(solution: Array, bias: Array, R: Array, t: Array, pivot: Array, v: Array, out: Array) -> Array:
    """Covariance, (6, 6), of a turn about the camera and of the translation; `out`: sigmas of `PoseSigma`.

    What remains unknown of the edges' common bias is a shift of the pose: an apparent depth of all rims one along the
    sheet's normal, a common shift in the picture one across the view.
    """
    n = R[:, 2].copy()
    J = np.zeros((6, 3))
    J[3, 0], J[4, 1] = pivot[2] / v[0], pivot[2] / v[1]
    J[3:, 2] = n
    cov = solution[:6, :6] + J @ np.ascontiguousarray(bias[:3, :3]) @ J.T
    distance = n @ t
    axis = np.array([0.0, 0.0, distance / max(n[2], 1e-6)])
    tz, along = np.zeros(6), np.zeros(6)
    a, b = t - pivot, axis - pivot
    tz[0], tz[1], tz[5] = a[1], -a[0], 1.0  # (w x a)_z + shift_z
    along[:3] = np.cross(n, pivot)
    along[3:] = n
    slope, across = np.zeros((2, 6)), np.zeros((2, 6))
    slope[0, 1], slope[0, 2], slope[1, 0], slope[1, 2] = n[2], -n[1], -n[2], n[0]  # w x n
    across[0, 1], across[0, 2], across[0, 3] = b[2], -b[1], 1.0  # (w x b) + shift, at the axis
    across[1, 0], across[1, 2], across[1, 4] = -b[2], b[0], 1.0
    turn, place = slope @ cov @ slope.T, across @ cov @ across.T
    tilt2 = n[0] * n[0] + n[1] * n[1]
    if tilt2 > 4.0 * (turn[0, 0] + turn[1, 1]):
        tilt_variance = (n[0] * n[0] * turn[0, 0] + 2.0 * n[0] * n[1] * turn[0, 1] + n[1] * n[1] * turn[1, 1]) / tilt2
    else:  # too near to parallel for the tilt to have a direction
        tilt_variance = 0.5 * (turn[0, 0] + turn[1, 1])
    out[0], out[1] = math.sqrt(tz @ cov @ tz), math.sqrt(along @ cov @ along)
    out[2], out[3] = math.sqrt(tilt_variance), math.sqrt(0.5 * (place[0, 0] + place[1, 1]))
    to_origin = np.eye(6)  # a turn about the pivot moves the origin: w x (t - pivot)
    to_origin[3, 1], to_origin[3, 2], to_origin[4, 0] = a[2], -a[1], -a[2]
    to_origin[4, 2], to_origin[5, 0], to_origin[5, 1] = a[0], a[1], -a[0]
    return to_origin @ cov @ to_origin.T


def _telling(refined: Refined, lattice: Lattice, scale: float) -> NDArray[np.bool_]:
    """Tubes whose own rim tells their place, (n,), of those that are used; `scale` in px per mm."""
    own = np.sqrt((refined.rims.covariance_px[:, 0] + refined.rims.covariance_px[:, 2]) / 2)
    return np.asarray(refined.used & (own < max(TELLING_PX, TELLING_SCATTERS * lattice.scatter_mm * scale)))


def _posterior(refined: Refined, lattice: Lattice, measured: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Centres, (n, 2) px, and one sigma per axis, (n,)."""
    fit, n = refined.fit, len(refined.sites)
    camera, columns = fit.camera, 16 if fit.names else 6
    px, J, place = np.empty((n, 2)), np.empty((n, 2, columns)), np.empty((n, 2, 3))
    f, sx = camera.focal_length_mm or 1.0, camera.sx or 1.0
    linearise(
        camera.vector(), f, sx, fit.rotation, fit.translation_mm, fit.pivot_mm, refined.sites.sheet_mm, columns, px, J,
        place,
    )  # fmt: skip
    if fit.names:
        J = np.ascontiguousarray(J[:, :, [*range(6), *(6 + PARAMETERS.index(name) for name in fit.names)]])
    center, variance = np.empty((n, 2)), np.empty(n)
    misfit = refined.common.misfit.variance_px2(px, refined.shape)
    _combine(
        px, J, place, fit.covariance, measured, refined.rims.center_px, refined.rims.covariance_px,
        lattice.scatter_mm**2, lattice.height_scatter_mm**2, misfit, center, variance,
    )  # fmt: skip
    return center, np.sqrt(variance + refined.common.bias.variance_px2(place))


@compiled
def _combine(
    px: Array, J: Array, place: Array, covariance: Array, used: NDArray[np.bool_], measured: Array, noise: Array,
    scatter2: float, height2: float, misfit: Array, center: Array, variance: Array,
) -> None:  # fmt: skip
    """Weighted mean of each tube's own centre and of where the pose puts it; variance per axis."""
    m = covariance.shape[0]
    for i in range(px.shape[0]):
        pxx, pxy, pyy = 0.0, 0.0, 0.0
        for q in range(m):
            gx, gy = 0.0, 0.0
            for p in range(m):
                gx += J[i, 0, p] * covariance[p, q]
                gy += J[i, 1, p] * covariance[p, q]
            pxx += gx * J[i, 0, q]
            pxy += gx * J[i, 1, q]
            pyy += gy * J[i, 1, q]
        if not used[i]:
            center[i] = px[i]
            variance[i] = 0.5 * (pxx + pyy)
            continue
        q = place[i]
        sxx = scatter2 * (q[0, 0] ** 2 + q[0, 1] ** 2) + height2 * q[0, 2] ** 2
        sxy = scatter2 * (q[0, 0] * q[1, 0] + q[0, 1] * q[1, 1]) + height2 * q[0, 2] * q[1, 2]
        syy = scatter2 * (q[1, 0] ** 2 + q[1, 1] ** 2) + height2 * q[1, 2] ** 2
        cxx, cxy, cyy = noise[i, 0], noise[i, 1], noise[i, 2]
        txx, txy, tyy = sxx + cxx, sxy + cxy, syy + cyy
        det = txx * tyy - txy * txy
        # gain G = S (S + C)^-1: what the tube's own centre counts for
        g00, g01 = (sxx * tyy - sxy * txy) / det, (sxy * txx - sxx * txy) / det
        g10, g11 = (sxy * tyy - syy * txy) / det, (syy * txx - sxy * txy) / det
        dx, dy = measured[i, 0] - px[i, 0], measured[i, 1] - px[i, 1]
        center[i, 0], center[i, 1] = px[i, 0] + g00 * dx + g01 * dy, px[i, 1] + g10 * dx + g11 * dy
        own = g00 * cxx + g01 * cxy + g10 * cxy + g11 * cyy
        a, b, c, d = 1.0 - g00, -g01, -g10, 1.0 - g11
        shared = a * a * pxx + 2.0 * a * b * pxy + b * b * pyy + c * c * pxx + 2.0 * c * d * pxy + d * d * pyy
        variance[i] = 0.5 * (own + shared) + misfit[i]
