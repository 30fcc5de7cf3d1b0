"""What all edges of a picture have in common and no residual shows: found, taken away, or put into sigma."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_in_place, median_of
from service.vision.pose import TUKEY
from service.vision.rims import solve_feet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.pose import Fit
    from service.vision.rims import EdgeProfile, Rims

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Common", "EdgeBias", "Misfit", "edge_bias", "smooth_misfit"]

BIAS_STRENGTH = 6.0
BIAS_TUBES = 8
BIAS_RAYS = 0.5
MOST_FEET = 120
"""So many tubes' feet tell what there is to be told."""
BIAS_PRIOR = np.array([0.35, 0.35, 3.0, 0.07])
"""One sigma of the common shift (x, y mm), of the edges' apparent depth (mm) and of the light's part before a picture
says anything."""
BIAS_FLOOR, BIAS_NOISE = np.array([0.01, 0.01, 0.05, 0.3]), np.array([0.1, 0.1, 0.7, 7.0])
"""What the correction leaves, measured on truth: at the least, and more per mm (the light's part: px) of the centres'
usual noise."""
FORGOTTEN = 0.8
"""Part of the earlier pictures' information that goes on to the next."""
UNSEEN = 1e-3
"""Fields that the solution takes up all but this part of tell nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeBias:
    """What light does to all edges of a picture in common.

    Lit bore walls and glints on weld beads move every edge alike, and outwards or inwards with the angle of view, just
    as if all rims lay deeper, or with the light's own slope. No residual of the pose shows it.

    Attributes
    ----------
    values
        (4,) shift x and y (px), depth (mm), light (in units of `Rims.light_px`).
    information
        (4, 4) that the pictures gave.
    covariance
        (4, 4): what remains unknown of the values, with what the estimate itself may be wrong by.
    """

    values: NDArray[np.float64]
    information: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def of(self, place: Array, light_px: Array) -> Array:
        """The shift of each edge, (n, 2) px."""
        x, y, depth, light = self.values
        return np.asarray(np.array([x, y]) + depth * place[:, :, 2] + light * light_px, np.float64)

    def variance_px2(self, place: Array) -> Array:
        """What remains unknown of shift and depth at each place, (n,) px^2 per axis; the light is in the pose's."""
        B = np.zeros((len(place), 2, 3))
        B[:, 0, 0] = B[:, 1, 1] = 1.0
        B[:, :, 2] = place[:, :, 2]
        return np.asarray(np.einsum("nij,jk,nik->n", B, self.covariance[:3, :3], B) / 2, np.float64)


def edge_bias(rims: Rims, used: NDArray[np.bool_], place: Array, before: EdgeBias | None) -> EdgeBias:
    """What the edges have in common, as the difference between whole edges and their feet on the clearest tubes.

    It changes slowly: what the picture `before` knew of it counts for as much as FORGOTTEN leaves.
    """
    scale = median_of(np.hypot(place[used, 0, 0], place[used, 0, 1]))
    units = np.array([scale, scale, 1.0, 1.0])
    prior, mean = np.diag((BIAS_PRIOR * units) ** -2.0), np.zeros(4)
    most = MOST_FEET
    if before is not None:
        prior, mean, most = prior + FORGOTTEN * before.information, before.values, MOST_FEET // 3
    noise_px = median_of(np.sqrt((rims.covariance_px[used, 0] + rims.covariance_px[used, 2]) / 2))
    rest = BIAS_FLOOR + BIAS_NOISE * np.array([1.0, 1.0, 1.0, scale]) * (noise_px / scale)
    floor = np.diag((rest * units) ** 2)
    which = np.flatnonzero(used)
    which = which[:: len(which) // most + 1]
    shift, covariance, quality = solve_feet(rims, which)
    good = (quality[:, 0] > BIAS_STRENGTH) & (quality[:, 1] > BIAS_RAYS)
    if good.sum() < BIAS_TUBES:
        return EdgeBias(mean, prior, _inverse(prior) + floor)
    which = which[good]
    b, N = _common(
        rims.shift_px[which] - shift[good], place[which, :, 2], rims.light_px[which],
        1.0 / (covariance[good, 0] + covariance[good, 2]), prior, mean,
    )  # fmt: skip
    return EdgeBias(b, N, _inverse(N) + floor)


def _inverse(information: Array) -> Array:
    return np.asarray(np.linalg.inv(information), np.float64)


@compiled
def _common(
    difference: Array, depth: Array, light: Array, information: Array, prior: Array, mean: Array
) -> tuple[Array, Array]:
    """Fit ``difference = shift + depth * b2 + light * b3`` by Tukey's biweight; b (4,) and its information (4, 4)."""
    n = difference.shape[0]
    b = mean.copy()
    N, row = np.zeros((4, 4)), np.zeros(4)
    stray = np.empty(2 * n)
    spread = math.inf
    for _ in range(5):
        N[:] = prior
        y = prior @ mean
        for i in range(n):
            for axis in range(2):
                row[0], row[1] = 1.0 - axis, 1.0 * axis
                row[2], row[3] = depth[i, axis], light[i, axis]
                r = (difference[i, axis] - row @ b) * math.sqrt(information[i]) / (TUKEY * spread)
                if r * r >= 1.0:
                    continue
                w = information[i] * (1.0 - r * r) ** 2
                if spread < math.inf:
                    w /= spread * spread
                for p in range(4):
                    y[p] += w * row[p] * difference[i, axis]
                    for q in range(4):
                        N[p, q] += w * row[p] * row[q]
        b[:] = np.linalg.solve(N, y)
        for i in range(n):
            for axis in range(2):
                row[0], row[1] = 1.0 - axis, 1.0 * axis
                row[2], row[3] = depth[i, axis], light[i, axis]
                stray[2 * i + axis] = abs(difference[i, axis] - row @ b) * math.sqrt(information[i])
        spread = max(1.4826 * median_in_place(stray, 2 * n), 0.3)
    return b, N


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """How far the centres stray from the pose by something smooth over the picture: light, lens, a bent sheet.

    Attributes
    ----------
    sigma_px
        One sigma of the coefficient of each smooth field: second-order polynomials over half the picture.
    covariance
        (6 + k, 6 + k): what such fields do to the solution, which takes up its share of them unseen.
    """

    sigma_px: float
    covariance: NDArray[np.float64]

    def variance_px2(self, center_px: Array, shape: tuple[int, ...]) -> Array:
        """What the fields do to centres, (n, 2), of a picture of that shape: (n,) per axis."""
        h, w = shape[:2]
        x2, y2 = (center_px[:, 0] / (0.5 * w) - 1.0) ** 2, (center_px[:, 1] / (0.5 * h) - 1.0) ** 2
        return np.asarray(self.sigma_px**2 * (1.0 + x2 + y2 + x2 * x2 + x2 * y2 + y2 * y2))  # the fields' squares


def smooth_misfit(fit: Fit, center_px: Array, shape: tuple[int, ...]) -> Misfit:
    """Measure the smooth part of the residuals that the solution could not take up, and infer the part that it could.

    Smooth fields are fitted to the residuals. What they explain beyond chance tells their size; the solution is then
    as wrong as fields of that size would make it.

    Parameters
    ----------
    center_px
        (n, 2) predicted centres of the solution's points.
    shape
        The picture's height and width.
    """
    scale = max(1.0, fit.scatter_factor**2)
    seen, cross, pull = _smooth_sums(
        center_px, shape[1], shape[0], fit.information, fit.weight, fit.residual_px, fit.gradient
    )
    response = fit.covariance @ cross / scale
    seen -= cross.T @ response
    eigen, vectors = np.linalg.eigh(seen)
    clear = eigen > UNSEEN * eigen[-1]
    explained = float(np.sum((vectors.T @ pull)[clear] ** 2 / eigen[clear])) / scale
    variance = max(0.0, (explained - float(clear.sum())) / float(eigen[clear].sum()) * scale)
    return Misfit(variance**0.5, np.asarray(variance * response @ response.T, np.float64))


@compiled
def _smooth_sums(
    center: Array, width: int, height: int, information: Array, weight: Array, residual: Array, gradient: Array
) -> tuple[Array, Array, Array]:
    """Normal equations of the smooth fields, (12, 12); theirs with the solution's unknowns; and with the residuals.

    The fields are the polynomials of second order along x, then those along y.
    """
    m = gradient.shape[2]
    seen, cross, pull, f = np.zeros((12, 12)), np.zeros((m, 12)), np.zeros(12), np.empty(6)
    for i in range(center.shape[0]):
        if weight[i] <= 0.0:
            continue
        x, y = (center[i, 0] - 0.5 * width) / (0.5 * width), (center[i, 1] - 0.5 * height) / (0.5 * height)
        f[0], f[1], f[2], f[3], f[4], f[5] = 1.0, x, y, x * x, x * y, y * y
        xx, xy, yy = weight[i] * information[i, 0], weight[i] * information[i, 1], weight[i] * information[i, 2]
        px, py = xx * residual[i, 0] + xy * residual[i, 1], xy * residual[i, 0] + yy * residual[i, 1]
        for p in range(6):
            pull[p] += f[p] * px
            pull[6 + p] += f[p] * py
            for q in range(6):
                g = f[p] * f[q]
                seen[p, q] += g * xx
                seen[p, 6 + q] += g * xy
                seen[6 + p, q] += g * xy
                seen[6 + p, 6 + q] += g * yy
        for k in range(m):
            jx = gradient[i, 0, k] * xx + gradient[i, 1, k] * xy
            jy = gradient[i, 0, k] * xy + gradient[i, 1, k] * yy
            for p in range(6):
                cross[k, p] += jx * f[p]
                cross[k, 6 + p] += jy * f[p]
    return seen, cross, pull


@dataclass(frozen=True, slots=True, eq=False)
class Common:
    """What changes slowly from picture to picture: it need not be found anew on each."""

    profile: EdgeProfile
    bias: EdgeBias
    misfit: Misfit
