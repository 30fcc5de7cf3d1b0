"""What all edges of a picture have in common and no residual shows: found, taken away, or put into sigma."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.pose import TUKEY
from service.vision.rims import solve_feet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.pose import Fit
    from service.vision.rims import Rims, RimSamples

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["EdgeBias", "Misfit", "edge_bias", "smooth_misfit"]

BIAS_STRENGTH = 6.0
BIAS_TUBES = 8
BIAS_PRIOR = np.array([0.35, 0.35, 3.0, 0.07])
"""One sigma of the common shift (x, y mm), of the edges' apparent depth (mm) and of the light's part before a picture
says anything."""
BIAS_FLOOR, BIAS_NOISE = np.array([0.01, 0.01, 0.05, 0.3]), np.array([0.1, 0.1, 0.7, 7.0])
"""What the correction leaves, measured on truth: at the least, and more per mm (the light's part: px) of the centres'
usual noise."""
UNSEEN = 1e-3
"""Fields that the solution takes up all but this part of tell nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeBias:
    """What light does to all edges of a picture in common.

    Lit bore walls and glints on weld beads move every edge alike (`shift_px`) and outwards or inwards with the angle of
    view, just as if all rims lay `depth_mm` deeper, or with the light's own slope. No residual of the pose shows it.

    Attributes
    ----------
    shift_px, depth_mm, light
        The estimate; `light` in units of `Rims.light_px`.
    covariance
        (4, 4) of (x px, y px, depth mm, light): what remains unknown of it.
    """

    shift_px: NDArray[np.float64]
    depth_mm: float
    light: float
    covariance: NDArray[np.float64]

    def of(self, place: Array, light_px: Array) -> Array:
        """The shift of each edge, (n, 2) px."""
        return np.asarray(self.shift_px + self.depth_mm * place[:, :, 2] + self.light * light_px, np.float64)

    def variance_px2(self, place: Array) -> Array:
        """What remains unknown of shift and depth at each place, (n,) px^2 per axis; the light is in the pose's."""
        B = np.zeros((len(place), 2, 3))
        B[:, 0, 0] = B[:, 1, 1] = 1.0
        B[:, :, 2] = place[:, :, 2]
        return np.asarray(np.einsum("nij,jk,nik->n", B, self.covariance[:3, :3], B) / 2, np.float64)


def edge_bias(samples: RimSamples, rims: Rims, used: NDArray[np.bool_], place: Array) -> EdgeBias:
    """What the edges have in common, as the difference between whole edges and their feet on the clearest tubes."""
    scale = float(np.median(np.linalg.norm(place[used, 0, :2], axis=1)))
    units = np.array([scale, scale, 1.0, 1.0])
    prior = np.diag((BIAS_PRIOR * units) ** -2.0)
    noise_px = float(np.median(np.sqrt((rims.covariance_px[used, 0] + rims.covariance_px[used, 2]) / 2)))
    rest = BIAS_FLOOR + BIAS_NOISE * np.array([1.0, 1.0, 1.0, scale]) * (noise_px / scale)
    floor = np.diag((rest * units) ** 2)
    which = np.flatnonzero(used)
    feet = solve_feet(samples, which)
    good = (feet.strength > BIAS_STRENGTH) & (feet.rays > 0.5)
    if good.sum() < BIAS_TUBES:
        return EdgeBias(np.zeros(2), 0.0, 0.0, np.asarray(np.linalg.inv(prior) + floor, np.float64))
    which = which[good]
    difference = (rims.shift_px[which] - feet.shift_px[good]).ravel()
    A = np.zeros((2 * len(which), 4))
    A[0::2, 0] = A[1::2, 1] = 1.0
    A[:, 2], A[:, 3] = place[which, :, 2].ravel(), rims.light_px[which].ravel()
    information = np.repeat(1.0 / (feet.covariance_px[good, 0] + feet.covariance_px[good, 2]), 2)
    weight, b, N = information.copy(), np.zeros(4), prior
    for _ in range(5):
        N = (A.T * weight) @ A + prior
        b = np.linalg.solve(N, (A.T * weight) @ difference)
        stray = np.abs(difference - A @ b) * np.sqrt(information)
        spread = max(1.4826 * float(np.median(stray)), 0.3)
        weight = information / spread**2 * np.clip(1 - (stray / (TUKEY * spread)) ** 2, 0.0, None) ** 2
    return EdgeBias(b[:2], float(b[2]), float(b[3]), np.asarray(np.linalg.inv(N) + floor, np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """How far the centres stray from the pose by something smooth over the picture: light, lens, a bent sheet.

    Attributes
    ----------
    sigma_px
        One sigma of the coefficient of each smooth field (`_fields`).
    covariance
        (6 + k, 6 + k): what such fields do to the solution, which takes up its share of them unseen.
    variance_px2
        (n,) what they do to the place of each centre, per axis.
    """

    sigma_px: float
    covariance: NDArray[np.float64]
    variance_px2: NDArray[np.float64]


def smooth_misfit(fit: Fit, center_px: Array, size_px: tuple[int, int], everywhere_px: Array) -> Misfit:
    """Measure the smooth part of the residuals that the solution could not take up, and infer the part that it could.

    Smooth fields (polynomials of second order) are fitted to the residuals. What they explain beyond chance tells
    their size; the solution is then as wrong as fields of that size would make it.

    Parameters
    ----------
    center_px
        (n, 2) predicted centres of the solution's points.
    size_px
        The picture's width and height.
    everywhere_px
        (m, 2) centres whose `variance_px2` is asked for.
    """
    fields = _fields(center_px, size_px)
    xx, xy, yy = fit.information.T * fit.weight
    W = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    J, scale = fit.gradient, max(1.0, fit.scatter_factor**2)
    WF, WJ = np.einsum("nij,njm->nim", W, fields), np.einsum("nij,njp->nip", W, J)
    cross = np.einsum("nip,nim->pm", WJ, fields)
    response = fit.covariance / scale @ cross
    seen = np.einsum("nim,nik->mk", WF, fields) - cross.T @ response
    pull = np.einsum("nim,ni->m", WF, fit.residual_px)
    eigen, vectors = np.linalg.eigh(seen)
    clear = eigen > UNSEEN * eigen[-1]
    explained = float(np.sum((vectors.T @ pull)[clear] ** 2 / eigen[clear])) / scale
    excess = (explained - float(clear.sum())) / float(eigen[clear].sum()) * scale
    variance = max(excess, 0.0)
    everywhere = _fields(everywhere_px, size_px)
    return Misfit(
        variance**0.5,
        np.asarray(variance * response @ response.T, np.float64),
        variance * np.einsum("nim,nim->n", everywhere, everywhere) / 2,
    )


def _fields(center_px: Array, size_px: tuple[int, int]) -> Array:
    """Smooth fields at picture points, (n, 2, 12): second-order polynomials along x, then along y."""
    w, h = size_px
    x, y = (center_px[:, 0] - 0.5 * w) / (0.5 * w), (center_px[:, 1] - 0.5 * h) / (0.5 * h)
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    out = np.zeros((len(x), 2, 12))
    out[:, 0, :6] = out[:, 1, 6:] = terms
    return out
