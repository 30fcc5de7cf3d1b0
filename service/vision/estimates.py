"""What a refined pose says to users: tubes and pose, each with its sigma."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_of
from service.vision.measurement import Pose, PoseSigma, Tubes
from service.vision.pose import PARAMETERS, POSE, linearise
from service.vision.systematics import bias_variance, misfit_variance

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
    center, sigma, measured = _posterior(refined, lattice)
    usual = median_of(sigma[measured if measured.any() else refined.used])
    pose = _pose(refined, lattice, camera, parity, usual / refined.scale)
    if parity is not None:
        center = center * [1.0, 2.0] + [0.0, parity]
        sigma = sigma * math.sqrt(2.5)  # per axis of the full frame: rms of 1 and 2
    tubes = Tubes(
        row=refined.sites.row.astype(np.int32),
        column=refined.sites.column.astype(np.int32),
        center_px=center,
        sigma_px=sigma,
        origin=measured.view(np.uint8),
        state=refined.state,
    )
    there = np.isfinite(center[:, 0])  # the last solution may have moved a place beyond a bent lens's fold
    return pose, tubes if there.all() else tubes.take(there)


def _pose(refined: Refined, lattice: Lattice, camera: Camera, parity: int | None, tube_sigma_mm: float) -> Pose:
    fit = refined.fit
    R, t = fit.rotation, fit.translation_mm
    out = np.empty(5)
    covariance = _pose_figures(
        fit.covariance, refined.common.bias.covariance, R, t, fit.pivot_mm, fit.camera.vector(), fit.residual_px,
        fit.weight, out,
    )  # fmt: skip
    distance = float(R[:, 2] @ t)
    pitch = distance * lattice.pitch_sigma_mm / lattice.pitch_mm
    k = 6 + fit.names.index("focal_length_mm") if "focal_length_mm" in fit.names else None
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
        reprojection_error_px=float(out[4]),
    )


@compiled
def _pose_figures(
    solution: Array, bias: Array, R: Array, t: Array, pivot: Array, v: Array, residual: Array, weight: Array, out: Array
) -> Array:
    """Covariance, (6, 6), of a turn about the camera and of the translation; `out`: sigmas, and rms of the residuals.

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
    squares, counted = 0.0, 0
    for i in range(weight.shape[0]):
        if weight[i] > 0.0:
            squares += residual[i, 0] * residual[i, 0] + residual[i, 1] * residual[i, 1]
            counted += 2
    out[4] = math.sqrt(squares / counted) if counted else 0.0
    to_origin = np.eye(6)  # a turn about the pivot moves the origin: w x (t - pivot)
    to_origin[3, 1], to_origin[3, 2], to_origin[4, 0] = a[2], -a[1], -a[2]
    to_origin[4, 2], to_origin[5, 0], to_origin[5, 1] = a[0], a[1], -a[0]
    return to_origin @ cov @ to_origin.T


def _posterior(refined: Refined, lattice: Lattice) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Centres, (n, 2) px, one sigma per axis, (n,), and whether the tube's own rim tells its place, (n,)."""
    fit, n, (height, width) = refined.fit, len(refined.sites), refined.shape[:2]
    camera = fit.camera
    free = np.array([*range(POSE), *(POSE + PARAMETERS.index(name) for name in fit.names)])
    center, sigma, measured = np.empty((n, 2)), np.empty(n), np.empty(n, np.bool_)
    telling = max(TELLING_PX, TELLING_SCATTERS * lattice.scatter_mm * refined.scale)
    _combine(
        camera.vector(), camera.focal_length_mm or 1.0, camera.sx or 1.0, fit.rotation, fit.translation_mm,
        fit.pivot_mm, refined.sites.sheet_mm, free, fit.covariance, refined.used, refined.rims.center_px,
        refined.rims.covariance_px, telling**2, lattice.scatter_mm**2, lattice.height_scatter_mm**2,
        refined.common.misfit.sigma_px, refined.common.bias.covariance, width, height, center, sigma, measured,
    )  # fmt: skip
    return center, sigma, measured


@compiled
def _combine(
    v: Array, f_mm: float, sx: float, R: Array, t: Array, pivot: Array, sheet: Array, free: NDArray[np.int64],
    covariance: Array, used: NDArray[np.bool_], seen: Array, noise: Array, telling2: float, scatter2: float,
    height2: float, misfit: float, bias: Array, width: int, height: int, center: Array, sigma: Array,
    measured: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Weighted mean of each tube's own centre, where it tells, and of where the pose puts it; sigma per axis."""
    n, m = sheet.shape[0], free.shape[0]
    columns = POSE if m == POSE else POSE + len(PARAMETERS)
    px, J, place = np.empty((n, 2)), np.empty((n, 2, columns)), np.empty((n, 2, 3))
    linearise(v, f_mm, sx, R, t, pivot, sheet, columns, px, J, place)
    for i in range(n):
        measured[i] = used[i] and 0.5 * (noise[i, 0] + noise[i, 2]) < telling2
        pxx, pxy, pyy = 0.0, 0.0, 0.0
        for q in range(m):
            gx, gy = 0.0, 0.0
            for p in range(m):
                gx += J[i, 0, free[p]] * covariance[p, q]
                gy += J[i, 1, free[p]] * covariance[p, q]
            pxx += gx * J[i, 0, free[q]]
            pxy += gx * J[i, 1, free[q]]
            pyy += gy * J[i, 1, free[q]]
        q = place[i]
        shared = bias_variance(bias, q[0, 2], q[1, 2])
        if not measured[i]:
            center[i] = px[i]
            sigma[i] = math.sqrt(0.5 * (pxx + pyy) + shared)
            continue
        sxx = scatter2 * (q[0, 0] ** 2 + q[0, 1] ** 2) + height2 * q[0, 2] ** 2
        sxy = scatter2 * (q[0, 0] * q[1, 0] + q[0, 1] * q[1, 1]) + height2 * q[0, 2] * q[1, 2]
        syy = scatter2 * (q[1, 0] ** 2 + q[1, 1] ** 2) + height2 * q[1, 2] ** 2
        cxx, cxy, cyy = noise[i, 0], noise[i, 1], noise[i, 2]
        txx, txy, tyy = sxx + cxx, sxy + cxy, syy + cyy
        det = txx * tyy - txy * txy
        # gain G = S (S + C)^-1: what the tube's own centre counts for
        g00, g01 = (sxx * tyy - sxy * txy) / det, (sxy * txx - sxx * txy) / det
        g10, g11 = (sxy * tyy - syy * txy) / det, (syy * txx - sxy * txy) / det
        dx, dy = seen[i, 0] - px[i, 0], seen[i, 1] - px[i, 1]
        center[i, 0], center[i, 1] = px[i, 0] + g00 * dx + g01 * dy, px[i, 1] + g10 * dx + g11 * dy
        own = g00 * cxx + g01 * cxy + g10 * cxy + g11 * cyy
        a, b, c, d = 1.0 - g00, -g01, -g10, 1.0 - g11
        by_pose = a * a * pxx + 2.0 * a * b * pxy + b * b * pyy + c * c * pxx + 2.0 * c * d * pxy + d * d * pyy
        shared += misfit_variance(misfit, px[i, 0], px[i, 1], width, height)
        sigma[i] = math.sqrt(0.5 * (own + by_pose) + shared)
