"""Pose of the sheet, and what is unknown of the camera, from measured tube centres.

One Gauss-Newton solution serves every case. The unknowns are a small turn and shift of the pose (6), followed by any
of the camera's parameters; a camera value with a sigma enters as a prior, one without a sigma stays out. Real tube
ends scatter about their nominal places: each centre is weighted by its own 2x2 covariance plus that of its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np

from service.vision.camera import TSAI, Camera, OpenCVLens, TsaiLens
from service.vision.cholesky import inverted, solved
from service.vision.compiled import compiled, median_of
from service.vision.projection import distort_jacobian, distort_point

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]

__all__ = [
    "MEDIAN_OF_TWO", "NO_PRIOR", "PARAMETERS", "POSE", "Fit", "Prior", "camera_with", "damped_step",
    "fit_pose", "linearise", "normal_equations", "pose_from_plane", "prior_of", "turned", "weigh",
]  # fmt: skip

POSE = 6
PARAMETERS = ("focal_length_mm", "sx", "cx_px", "cy_px", "kappa1_per_mm2", "k1", "k2", "p1", "p2", "k3")
"""The camera's parameters in the order of `linearise`'s columns, behind the six of the pose."""
STILL = 1e-3
"""A solution whose chi-square falls by less stands still."""
BENT = 0.3
"""How much an unknown lens may bend the edge of the picture, one sigma."""
TUKEY = 4.685
"""Tukey's constant: 95 % efficiency where errors are normal."""
MOST_OVERSTEP = 1.6
"""Most by which a step may be longer than one for constant weights."""
MEDIAN_OF_TWO = 1.386
"""Median of chi-square with two degrees of freedom."""
AS_ASSUMED = 10.0
"""So many centres more are thought to stray by as much as they are assumed to, where the others stray by less."""


@compiled
def linearise(
    v: Array, f_mm: float, sx: float, R: Array, t: Array, pivot: Array, sheet_mm: Array, columns: int,
    px: Array, J: Array, place: Array,
) -> None:  # fmt: skip
    """Project sheet points and differentiate.

    Parameters
    ----------
    v, f_mm, sx
        Intrinsics (`camera.lens_vector`), focal length and horizontal scale.
    R, t, pivot
        camera_from_sheet; the turn is about `pivot` (3,), mm in the camera frame.
    sheet_mm
        (n, 2), Z = 0.
    columns
        6 for the pose alone, 16 for the camera's `PARAMETERS` as well.
    px, J, place
        Out: (n, 2) px; (n, 2, columns); (n, 2, 3) px per mm of the point's own place.
    """
    tsai = v[4] == TSAI
    for i in range(sheet_mm.shape[0]):
        x, y = sheet_mm[i, 0], sheet_mm[i, 1]
        xc = R[0, 0] * x + R[0, 1] * y + t[0]
        yc = R[1, 0] * x + R[1, 1] * y + t[1]
        zc = R[2, 0] * x + R[2, 1] * y + t[2]
        if not zc > 0.0:
            px[i, 0] = px[i, 1] = math.nan
            J[i] = 0.0
            place[i] = 0.0
            continue
        u, w = xc / zc, yc / zc
        xd, yd = distort_point(v, u, w)
        px[i, 0], px[i, 1] = v[2] + v[0] * xd, v[3] + v[1] * yd
        if math.isnan(xd):
            J[i] = 0.0
            place[i] = 0.0
            continue
        d00, d01, d10, d11 = distort_jacobian(v, u, w, xd, yd)
        a00, a01, a02 = v[0] * d00 / zc, v[0] * d01 / zc, -v[0] * (d00 * u + d01 * w) / zc
        a10, a11, a12 = v[1] * d10 / zc, v[1] * d11 / zc, -v[1] * (d10 * u + d11 * w) / zc
        for c in range(3):
            place[i, 0, c] = a00 * R[0, c] + a01 * R[1, c] + a02 * R[2, c]
            place[i, 1, c] = a10 * R[0, c] + a11 * R[1, c] + a12 * R[2, c]
        qx, qy, qz = xc - pivot[0], yc - pivot[1], zc - pivot[2]
        J[i, 0, 0], J[i, 1, 0] = a02 * qy - a01 * qz, a12 * qy - a11 * qz
        J[i, 0, 1], J[i, 1, 1] = a00 * qz - a02 * qx, a10 * qz - a12 * qx
        J[i, 0, 2], J[i, 1, 2] = a01 * qx - a00 * qy, a11 * qx - a10 * qy
        J[i, 0, 3], J[i, 1, 3], J[i, 0, 4], J[i, 1, 4], J[i, 0, 5], J[i, 1, 5] = a00, a10, a01, a11, a02, a12
        if columns == 6:
            continue
        for c in range(6, columns):
            J[i, 0, c] = J[i, 1, c] = 0.0
        J[i, 0, 6], J[i, 1, 6] = v[0] * xd / f_mm, v[1] * yd / f_mm
        J[i, 0, 7] = v[0] * xd / sx
        J[i, 0, 8] = J[i, 1, 9] = 1.0
        if tsai:
            r2 = xd * xd + yd * yd
            k0, k1 = -v[0] * (d00 * xd + d01 * yd) * r2, -v[1] * (d10 * xd + d11 * yd) * r2
            J[i, 0, 10], J[i, 1, 10] = k0 * f_mm * f_mm, k1 * f_mm * f_mm
            J[i, 0, 6] += k0 * 2.0 * v[5] / f_mm
            J[i, 1, 6] += k1 * 2.0 * v[5] / f_mm
        else:
            r2 = u * u + w * w
            J[i, 0, 11], J[i, 1, 11] = v[0] * u * r2, v[1] * w * r2
            J[i, 0, 12], J[i, 1, 12] = v[0] * u * r2 * r2, v[1] * w * r2 * r2
            J[i, 0, 13], J[i, 1, 13] = v[0] * 2.0 * u * w, v[1] * (r2 + 2.0 * w * w)
            J[i, 0, 14], J[i, 1, 14] = v[0] * (r2 + 2.0 * u * u), v[1] * 2.0 * u * w
            J[i, 0, 15], J[i, 1, 15] = v[0] * u * r2 * r2 * r2, v[1] * w * r2 * r2 * r2


@compiled
def _vector(theta: Array, kind: float, pitch_mm: Array, fold: float, v: Array) -> None:
    """Write `camera.lens_vector` of the parameters `theta` (10,), in the order of PARAMETERS."""
    f = theta[0]
    v[0], v[1], v[2], v[3], v[4] = theta[1] * f / pitch_mm[0], f / pitch_mm[1], theta[2], theta[3], kind
    if kind == TSAI:
        k = theta[4] * f * f
        v[5], v[6], v[7], v[8], v[9] = k, 0.0, 0.0, 0.0, 0.0
        v[10] = 4.0 / (27.0 * -k) if k < 0.0 else 1e9
        return
    for i in range(5):
        v[5 + i] = theta[5 + i]
    v[10] = fold
    if fold > 0.0:
        return
    v[10] = 1e9
    for i in range(1, 601):  # the smallest q = r_u**2 where d r_d / d r_u vanishes, to 0.01
        q = 0.01 * i
        if 1.0 + q * (3.0 * theta[5] + q * (5.0 * theta[6] + q * 7.0 * theta[9])) <= 0.0:
            v[10] = q - 0.01
            return


@compiled
def turned(R: Array, w: Array) -> Array:
    """exp(w) @ R, re-orthonormalised: errors would otherwise grow from frame to frame."""
    a = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    s = math.sin(a) / a if a > 1e-9 else 1.0
    c = (1.0 - math.cos(a)) / (a * a) if a > 1e-6 else 0.5
    W = np.zeros((3, 3))
    W[0, 1], W[0, 2], W[1, 2] = -w[2], w[1], -w[0]
    W[1, 0], W[2, 0], W[2, 1] = w[2], -w[1], w[0]
    Q = R + s * (W @ R) + c * (W @ (W @ R))
    for _ in range(2):  # Newton's iteration to the nearest rotation
        Q = 1.5 * Q - 0.5 * Q @ (Q.T @ Q)
    return Q


@compiled
def _distances(
    z: Array, cov: Array, px: Array, place: Array, scatter2: float, height2: float, m2: Array, info: Array
) -> None:
    """Mahalanobis distances squared, (n,), and the information, (n, 3) xx xy yy, of each centre's residual."""
    for i in range(z.shape[0]):
        p = place[i]
        cxx = cov[i, 0] + scatter2 * (p[0, 0] * p[0, 0] + p[0, 1] * p[0, 1]) + height2 * p[0, 2] * p[0, 2]
        cxy = cov[i, 1] + scatter2 * (p[0, 0] * p[1, 0] + p[0, 1] * p[1, 1]) + height2 * p[0, 2] * p[1, 2]
        cyy = cov[i, 2] + scatter2 * (p[1, 0] * p[1, 0] + p[1, 1] * p[1, 1]) + height2 * p[1, 2] * p[1, 2]
        det = cxx * cyy - cxy * cxy
        info[i, 0], info[i, 1], info[i, 2] = cyy / det, -cxy / det, cxx / det
        dx, dy = z[i, 0] - px[i, 0], z[i, 1] - px[i, 1]
        d = info[i, 0] * dx * dx + 2.0 * info[i, 1] * dx * dy + info[i, 2] * dy * dy
        m2[i] = d if d < 1e12 else 1e12  # noqa: FURB136 - NaN (behind the camera, folded) as well


@compiled
def normal_equations(
    z: Array, px: Array, J: Array, info: Array, weight: Array, columns: NDArray[np.int64], A: Array, b: Array
) -> None:
    """Normal equations of the centres `z`, (n, 2), about their predictions, into `A` and `b`."""
    m = columns.shape[0]
    A[:] = 0.0
    b[:] = 0.0
    for i in range(z.shape[0]):
        w = weight[i]
        if w <= 0.0 or math.isnan(px[i, 0]):  # at the start of a solution even most points may have no image
            continue
        dx, dy = z[i, 0] - px[i, 0], z[i, 1] - px[i, 1]
        for p in range(m):
            jx, jy = J[i, 0, columns[p]], J[i, 1, columns[p]]
            gx, gy = w * (jx * info[i, 0] + jy * info[i, 1]), w * (jx * info[i, 1] + jy * info[i, 2])
            b[p] += gx * dx + gy * dy
            for q in range(p, m):
                A[p, q] += gx * J[i, 0, columns[q]] + gy * J[i, 1, columns[q]]
    for p in range(m):
        for q in range(p):
            A[p, q] = A[q, p]


@compiled
def weigh(m2: Array, scale: float, weight: Array) -> float:
    """Tukey's weights of Mahalanobis distances; gives the robust cost."""
    cut = scale * TUKEY * TUKEY
    cost = 0.0
    for i in range(m2.shape[0]):
        u = 1.0 - m2[i] / cut
        weight[i] = u * u if u > 0.0 else 0.0
        cost += 1.0 - u * u * u if u > 0.0 else 1.0
    return cost * cut / 3.0


@compiled
def _overstep(m2: Array, scale: float) -> float:
    """By how much a step falls short that takes Tukey's weights for constant: they fall off as residuals grow."""
    cut, sum_w, sum_slope = scale * TUKEY * TUKEY, 0.0, 0.0
    for i in range(m2.shape[0]):
        u = 1.0 - m2[i] / cut
        if u > 0.0:
            sum_w += u * u
            sum_slope += u * u - 2.0 * u * (1.0 - u)  # in two dimensions
    return min(sum_w / max(sum_slope, 0.5 * sum_w), MOST_OVERSTEP)


@compiled
def _most_have_an_image(px: Array) -> bool:
    """Whether a step may be judged by its cost: with all points behind the camera that is a finite one."""
    seen = 0
    for i in range(px.shape[0]):
        if not math.isnan(px[i, 0]):
            seen += 1
    return bool(2 * seen > px.shape[0])


@compiled
def _scale_of(m2: Array) -> float:
    """Robust variance of unit weight."""
    return max(median_of(m2) / MEDIAN_OF_TWO, 0.25)


@compiled
def _unit_of(scale: float, n: int) -> float:
    """Variance of unit weight that n centres' robust one makes likely: few of them may agree by chance."""
    return max(scale, (n * scale + AS_ASSUMED) / (n + AS_ASSUMED))


@compiled
def _prior_cost(theta: Array, free: NDArray[np.int64], info: Array, mean: Array) -> float:
    cost = 0.0
    for p in range(free.shape[0]):
        for q in range(free.shape[0]):
            cost += (theta[free[p]] - mean[p]) * info[p, q] * (theta[free[q]] - mean[q])
    return cost


@compiled
def damped_step(A: Array, b: Array, damping: float) -> Array:
    """Levenberg's step, scaled so that unlike parameters compare."""
    m = b.shape[0]
    d = np.empty(m)
    for p in range(m):
        d[p] = math.sqrt(A[p, p]) if A[p, p] > 0.0 else 1.0
    S = np.empty((m, m))
    for p in range(m):
        for q in range(m):
            S[p, q] = A[p, q] / (d[p] * d[q])
        S[p, p] += damping + 1e-12
    return solved(S, b / d) / d


@compiled
def _gauss_newton(
    theta: Array, kind: float, pitch_mm: Array, fold: float, R: Array, t: Array, sheet_mm: Array, z: Array, cov: Array,
    scatter2: float, height2: float, free: NDArray[np.int64], prior_info: Array, prior_mean: Array, iterations: int,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, float, float, bool]:  # fmt: skip
    """Solve robustly; gives theta, R, t, pivot, covariance, weight, info, px, J, scale, unit, converged.

    Levenberg's damping steps in only where a step makes the robust cost grow.
    """
    n, k = z.shape[0], free.shape[0]
    m, columns = 6 + k, 16 if k else 6
    index = np.arange(m)
    for i in range(k):
        index[6 + i] = 6 + free[i]
    middle = np.zeros(2)
    for i in range(n):
        middle += sheet_mm[i] / n
    v, px, J, place = np.empty(11), np.empty((n, 2)), np.empty((n, 2, columns)), np.empty((n, 2, 3))
    m2, info, weight = np.empty(n), np.empty((n, 3)), np.ones(n)
    A, b = np.empty((m, m)), np.empty(m)
    theta, damping, converged = theta.copy(), 0.0, False

    pivot = R[:, 0] * middle[0] + R[:, 1] * middle[1] + t
    _vector(theta, kind, pitch_mm, fold, v)
    linearise(v, theta[0], theta[1], R, t, pivot, sheet_mm, columns, px, J, place)
    _distances(z, cov, px, place, scatter2, height2, m2, info)
    for _ in range(iterations):
        scale = _scale_of(m2)
        cost = weigh(m2, scale, weight) + _prior_cost(theta, free, prior_info, prior_mean)
        normal_equations(z, px, J, info, weight, index, A, b)
        for p in range(k):
            for q in range(k):
                A[6 + p, 6 + q] += prior_info[p, q]
                b[6 + p] -= prior_info[p, q] * (theta[free[q]] - prior_mean[q])
        better, longer = False, _overstep(m2, scale)
        for _ in range(8):
            x = damped_step(A, b, damping)
            if damping == 0.0:
                x *= longer
            Q = turned(R, x[:3])
            tn = (Q @ R.T) @ (t - pivot) + pivot + x[3:6]
            trial = theta.copy()
            for p in range(k):
                trial[free[p]] += x[6 + p]
            trial[0] = max(trial[0], 0.3 * theta[0])
            turned_pivot = Q[:, 0] * middle[0] + Q[:, 1] * middle[1] + tn
            _vector(trial, kind, pitch_mm, fold, v)
            linearise(v, trial[0], trial[1], Q, tn, turned_pivot, sheet_mm, columns, px, J, place)
            _distances(z, cov, px, place, scatter2, height2, m2, info)
            new = weigh(m2, scale, weight) + _prior_cost(trial, free, prior_info, prior_mean)
            if new <= cost * (1.0 + 1e-9) and _most_have_an_image(px):
                better = True
                break
            damping = max(10.0 * damping, 1e-4)
        if not better:
            converged = True
            _vector(theta, kind, pitch_mm, fold, v)
            linearise(v, theta[0], theta[1], R, t, pivot, sheet_mm, columns, px, J, place)
            _distances(z, cov, px, place, scatter2, height2, m2, info)
            break
        R, t, theta, pivot = Q, tn, trial, turned_pivot
        damping *= 0.1
        if cost - new < STILL:
            converged = True
            break
    scale = _scale_of(m2)
    weigh(m2, scale, weight)
    normal_equations(z, px, J, info, weight, index, A, b)
    for p in range(k):
        for q in range(k):
            A[6 + p, 6 + q] += prior_info[p, q]
    unit = max(1.0, scale) if k else _unit_of(scale, n)  # an unknown camera explains away what centres stray
    return theta, R, t, pivot, inverted(A) * unit, weight, info, px, J, scale, unit, converged


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known beforehand of the camera parameters that are to be estimated.

    Attributes
    ----------
    names
        Out of `PARAMETERS`, in that order.
    mean, covariance
        (k,) and (k, k).
    """

    names: tuple[str, ...]
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]


NO_PRIOR = Prior((), np.zeros(0), np.zeros((0, 0)))
"""For a camera of which nothing is to be estimated."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A solved pose.

    Attributes
    ----------
    rotation, translation_mm, camera
        The answer; `camera` holds what was estimated of it.
    covariance
        (6 + k, 6 + k) of a small turn (rad) and shift (mm) **about `pivot_mm`**, and of the `names`.
    pivot_mm
        (3,) the sheet points' middle in the camera frame.
    names
        The k estimated camera parameters.
    weight
        (n,) Tukey weight of each centre; 0 where it was set aside.
    residual_px
        (n, 2) measured minus predicted.
    scatter_factor
        By how much the tubes' places scatter more than assumed (standard deviations).
    unit
        Variance of unit weight: what the centres' assumed covariances were multiplied with.
    converged
        Whether the solution stood still at the end.
    gradient, information
        (n, 2, 6 + k) of the predicted centres by the unknowns, and (n, 3) xx, xy, yy of the centres.
    """

    rotation: NDArray[np.float64]
    translation_mm: NDArray[np.float64]
    camera: Camera
    covariance: NDArray[np.float64]
    pivot_mm: NDArray[np.float64]
    names: tuple[str, ...]
    weight: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    scatter_factor: float
    unit: float
    converged: bool
    gradient: NDArray[np.float64]
    information: NDArray[np.float64]

    def sigma(self, name: str) -> float:
        """One sigma of a camera parameter; 0 where it was not estimated."""
        if name not in self.names:
            return 0.0
        k = POSE + self.names.index(name)
        return math.sqrt(float(self.covariance[k, k]))

    def widened(self, fields_px: NDArray[np.float64], more: NDArray[np.float64]) -> Fit:
        """The same with what no residual shows in its covariance.

        Parameters
        ----------
        fields_px
            (m, n, 2) shifts of all n centres together, one sigma each.
        more
            (6 + k, 6 + k) what else adds to the covariance.
        """
        covariance = self.covariance + more
        _widen(
            self.gradient, self.information, self.weight, fields_px,
            self.covariance / self.unit, covariance,
        )  # fmt: skip
        return replace(self, covariance=covariance)


@compiled
def _widen(
    gradient: Array, information: Array, weight: Array, fields: Array, response: Array, covariance: Array
) -> None:
    """Add to a covariance how the solution, which responds so to the right side of its equations, would follow."""
    m = gradient.shape[2]
    pull, moved = np.empty(m), np.empty(m)
    for f in range(fields.shape[0]):
        pull[:] = 0.0
        for i in range(gradient.shape[0]):
            xx, xy, yy = information[i, 0], information[i, 1], information[i, 2]
            x, y = weight[i] * fields[f, i, 0], weight[i] * fields[f, i, 1]
            for p in range(m):
                pull[p] += gradient[i, 0, p] * (xx * x + xy * y) + gradient[i, 1, p] * (xy * x + yy * y)
        for p in range(m):
            moved[p] = 0.0
            for q in range(m):
                moved[p] += response[p, q] * pull[q]
        for p in range(m):
            for q in range(m):
                covariance[p, q] += moved[p] * moved[q]


def prior_of(camera: Camera, focal_length_mm: float | None = None, lens: TsaiLens | OpenCVLens | None = None) -> Prior:
    """What a camera leaves open, with its priors.

    A parameter with a covariance keeps it. One that is missing gets a wide prior that only keeps a solution sane where
    a single frame says nothing: f unknown by itself, about `focal_length_mm` where that is given; C a tenth of the
    picture's width about its middle; sx 1 %; a lens that bends the picture's edge by a third. An unknown lens is of the
    kind of `lens`: Tsai's kappa1, or OpenCV's k1 and k2, each of which may bend the edge so much.
    """
    if camera.complete and not camera.parameters:
        return NO_PRIOR
    w = camera.image_size_px[0]
    mean, free = _parameter_vector(camera).copy(), {}
    known = dict(zip(camera.parameters, range(len(camera.parameters)), strict=True))
    if camera.focal_length_mm is None:
        mean[0] = focal_length_mm or mean[0]
        free["focal_length_mm"] = mean[0]
    if camera.sx is None:
        free["sx"] = 0.01
    if camera.principal_point_px is None:
        free["cx_px"] = free["cy_px"] = 0.1 * w
    edge2 = (w * camera.pixel_pitch_mm[0] / 2) ** 2
    if camera.lens is None and isinstance(lens, OpenCVLens):
        q = edge2 / mean[0] ** 2
        free["k1"], free["k2"] = BENT / q, BENT / q**2
    elif camera.lens is None:
        free["kappa1_per_mm2"] = BENT / edge2
    names = tuple(p for p in PARAMETERS if p in free or (p in known and camera.covariance[known[p], known[p]] > 0))
    covariance = np.zeros((len(names), len(names)))
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            if a in known and b in known:
                covariance[i, j] = camera.covariance[known[a], known[b]]
        if a in free:
            covariance[i, i] = free[a] ** 2
    return Prior(names, np.array([mean[PARAMETERS.index(n)] for n in names]), covariance)


@lru_cache(maxsize=64)
def _parameter_vector(camera: Camera) -> NDArray[np.float64]:
    """The camera's PARAMETERS, (10,), not to be written to; unknown ones at their neutral start."""
    f = camera.focal_length_mm or 1.5 * camera.image_size_px[0] * camera.pixel_pitch_mm[0]
    lens = camera.lens.coefficients if isinstance(camera.lens, OpenCVLens) else (0.0,) * 5
    kappa1 = camera.lens.kappa1_per_mm2 if isinstance(camera.lens, TsaiLens) else 0.0
    return np.array([f, camera.sx or 1.0, *(camera.principal_point_px or camera.middle_px), kappa1, *lens])


def camera_with(camera: Camera, values: NDArray[np.float64]) -> Camera:
    """The camera with all PARAMETERS (10,) set; its lens model stays, Tsai's where it had none."""
    f, sx, cx, cy, kappa1, *opencv = (float(v) for v in values)
    k1, k2, p1, p2, k3 = opencv
    lens = OpenCVLens((k1, k2, p1, p2, k3)) if isinstance(camera.lens, OpenCVLens) else TsaiLens(kappa1)
    return replace(camera, focal_length_mm=f, sx=sx, principal_point_px=(cx, cy), lens=lens)


def fit_pose(
    sheet_mm: NDArray[np.float64],
    center_px: NDArray[np.float64],
    covariance_px: NDArray[np.float64],
    camera: Camera,
    rotation: NDArray[np.float64],
    translation_mm: NDArray[np.float64],
    lattice: Lattice,
    prior: Prior,
    *,
    iterations: int = 12,
) -> Fit:
    """Solve for the pose, and for the camera parameters that `prior` names.

    Parameters
    ----------
    sheet_mm, center_px
        (n, 2) nominal places and (n, 2) measured centres, n >= 4 and not in one line.
    covariance_px
        (n, 3) xx, xy, yy of the centres.
    camera
        Where it starts; complete but for what `prior` names.
    rotation, translation_mm
        Where the pose starts.
    lattice
        Its scatter is added to each centre's covariance.
    """
    start = _parameter_vector(camera)
    free = np.array([PARAMETERS.index(n) for n in prior.names], np.int64)
    known = np.asarray(np.linalg.inv(prior.covariance), np.float64) if len(free) else np.zeros((0, 0))
    opencv = isinstance(camera.lens, OpenCVLens)
    lens_free = any(PARAMETERS.index(n) >= 5 for n in prior.names)
    fold = -1.0 if lens_free or not opencv else float(camera.vector()[10])
    theta, R, t, pivot, covariance, weight, info, px, J, scale, unit, converged = _gauss_newton(
        start, 1.0 if opencv else TSAI, np.array(camera.pixel_pitch_mm), fold,
        np.ascontiguousarray(rotation), np.ascontiguousarray(translation_mm), sheet_mm, center_px, covariance_px,
        lattice.scatter_mm**2, lattice.height_scatter_mm**2, free, known, prior.mean, iterations,
    )  # fmt: skip
    return Fit(
        rotation=R,
        translation_mm=t,
        camera=camera_with(camera, theta) if prior.names else camera,
        covariance=covariance,
        pivot_mm=pivot,
        names=prior.names,
        weight=weight,
        residual_px=center_px - px,
        scatter_factor=math.sqrt(scale),
        unit=unit,
        converged=converged,
        gradient=J[:, :, [*range(POSE), *(POSE + free)]] if len(free) else J,
        information=info,
    )


def pose_from_plane(
    sheet_mm: NDArray[np.float64], undistorted: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Pose from a homography: R (3, 3), t (3,) mm; None where the points do not determine one.

    Parameters
    ----------
    sheet_mm, undistorted
        (n, 2) places and their undistorted normalised image points, n >= 4.
    """
    ok = np.isfinite(undistorted).all(axis=1)
    if ok.sum() < 4:
        return None
    scale = float(np.abs(sheet_mm[ok]).max()) or 1.0
    found, _ = cv2.findHomography(sheet_mm[ok] / scale, undistorted[ok], 0)
    if found is None or not np.isfinite(found).all():
        return None
    H = np.asarray(found @ np.diag([1 / scale, 1 / scale, 1.0]), np.float64)
    norm = math.sqrt(float(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1])))
    if not norm > 0:
        return None
    H = H / norm * (1.0 if H[2, 2] > 0 else -1.0)
    u, _, vt = np.linalg.svd(np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])]))
    R = u @ np.diag([1.0, 1.0, float(np.linalg.det(u @ vt))]) @ vt
    return R, np.ascontiguousarray(H[:, 2])
