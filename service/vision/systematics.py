"""What all edges of a picture have in common and no residual shows: put into sigma."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_in_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.edges import EdgeProfile
    from service.vision.pose import Fit

    Array: TypeAlias = NDArray[np.float64]

__all__ = [
    "Common", "EdgeBias", "Misfit", "bias_variance", "edge_bias", "lit_walls", "misfit_variance", "smooth_misfit",
]  # fmt: skip

DEPTH = 2
"""Which of the edges' common parts it is: behind shifts x and y, before the light."""

BIAS_FLOOR, BIAS_NOISE = np.array([0.003, 0.003, 0.005, 0.2]), np.array([0.05, 0.05, 0.2, 0.0])
"""One sigma of what shifts all edges in common, measured on truth: x, y and depth in mm, light in `Rims.light_px`, at
the least, and more per mm of the centres' usual noise."""
BIAS_BLUR = 0.01
"""The same of the depth, per mm of the edges' width: weld beads stand before the rim or behind it, and blur mixes
their parallax in."""
LIT_WALL, MOST_LIT = 0.25, 2.0
"""One sigma of a rim's apparent depth per mm of the edges' width where the bore is as bright over black as its edge is
high, measured on truth; brighter bores than that many times tell no more."""
SMOOTH = 0.036 * np.tile([1.0, 0.2, 0.2, 1.0, 1.0, 1.0], 2)
"""Size of the smooth fields that no residual shows, in edge widths, in `_smooth_sums`' order: what light does to edges,
measured on truth. That which grows straight with the place, as if the sheet were nearer, is smaller."""
UNSEEN = 1e-3
"""Fields that the solution takes up all but this part of tell nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeBias:
    """What light may do to all edges of a picture in common, and no residual of the pose shows.

    Lit bore walls and glints on weld beads move every edge alike, and outwards or inwards with the angle of view, just
    as if all rims lay deeper. What the model of a rim, with all its leans, leaves of it is declared, not found.

    Attributes
    ----------
    covariance
        (4, 4) of a shift x and y (px), of the rims' apparent depth (mm), and of the light's part (`Rims.light_px`).
    """

    covariance: NDArray[np.float64]


def edge_bias(covariance_px: Array, scale: float, width_px: float) -> EdgeBias:
    """What is declared of edges that wide, whose centres have these covariances, (n, 3) px^2; `scale` in px per mm."""
    covariance = np.zeros((4, 4))
    _edge_bias(covariance_px, scale, width_px, covariance)
    return EdgeBias(covariance)


@compiled
def _edge_bias(noise: Array, scale: float, width: float, covariance: Array) -> None:
    sigma = np.empty(noise.shape[0])
    for i in range(noise.shape[0]):
        sigma[i] = math.sqrt(0.5 * (noise[i, 0] + noise[i, 2])) / scale
    noise_mm = median_in_place(sigma, noise.shape[0])
    for k in range(4):
        of_one = BIAS_FLOOR[k] + BIAS_NOISE[k] * noise_mm + (BIAS_BLUR * width / scale if k == DEPTH else 0.0)
        covariance[k, k] = (of_one * (scale if k < DEPTH else 1.0)) ** 2


@compiled
def bias_variance(covariance: Array, x: float, y: float) -> float:
    """What shift and depth do to a place of which depth moves (x, y) px per mm, px^2 per axis; light is the pose's."""
    c = covariance
    depth = x * (c[2, 2] * x + 2.0 * c[0, 2]) + y * (c[2, 2] * y + 2.0 * c[1, 2])
    return float(0.5 * (c[0, 0] + c[1, 1] + depth))


def lit_walls(
    gain: Array, bore: Array, covariance_px: Array, place: Array, scale: float, width_px: float
) -> tuple[Array, Array]:
    """What the bores' lit walls may do: a field of shifts, (n, 2) px, of one sigma, and covariances that hold it.

    Seen aslant, a bore shows its wall on the far side only, where the tube end's light passes into the wall's without a
    step: as if the rim lay deeper. How bright the bore is tells how far that may reach. All are lit from one side, so
    the field is common to them.

    Parameters
    ----------
    gain, bore, covariance_px
        (n,), (n,) and (n, 3) as in `rims.Rims`.
    place
        (n, 2, 3) px per mm of the rims' places.
    scale, width_px
        Px per mm in the middle of them; the edges' width.
    """
    field, covariance = np.empty((len(place), 2)), np.empty((len(place), 3))
    _lit_walls(gain, bore, covariance_px, place, LIT_WALL * width_px / scale, field, covariance)
    return field, covariance


@compiled
def _lit_walls(
    gain: Array, bore: Array, before: Array, place: Array, depth_mm: float, field: Array, covariance: Array
) -> None:
    for i in range(place.shape[0]):
        lit = min(max(bore[i] / gain[i], 0.0), MOST_LIT) if gain[i] > 0.0 else MOST_LIT
        x, y = depth_mm * lit * place[i, 0, 2], depth_mm * lit * place[i, 1, 2]
        field[i, 0], field[i, 1] = x, y
        covariance[i, 0], covariance[i, 1] = before[i, 0] + x * x, before[i, 1] + x * y
        covariance[i, 2] = before[i, 2] + y * y


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


@compiled
def misfit_variance(sigma: float, x: float, y: float, width: int, height: int) -> float:
    """What smooth fields of that sigma do to a centre in a picture of that size, px^2 per axis."""
    x2, y2 = (x / (0.5 * width) - 1.0) ** 2, (y / (0.5 * height) - 1.0) ** 2
    return sigma * sigma * (1.0 + x2 + y2 + x2 * x2 + x2 * y2 + y2 * y2)  # the fields' squares


def smooth_misfit(fit: Fit, center_px: Array, shape: tuple[int, ...], width_px: float) -> Misfit:
    """Measure the smooth part of the residuals that the solution could not take up, and infer the part that it could.

    Smooth fields are fitted to the residuals. What they explain beyond chance tells their size; the solution is then
    as wrong as fields of that size would make it.

    Parameters
    ----------
    center_px
        (n, 2) predicted centres of the solution's points.
    shape
        The picture's height and width.
    width_px
        The edges' width.
    """
    scale = fit.unit
    seen, cross, pull = _smooth_sums(
        center_px, shape[1], shape[0], fit.information, fit.weight, fit.residual_px, fit.gradient
    )
    response = fit.covariance @ cross / scale
    seen -= cross.T @ response
    eigen, vectors = np.linalg.eigh(seen)
    clear = eigen > UNSEEN * eigen[-1]
    explained = float(np.sum((vectors.T @ pull)[clear] ** 2 / eigen[clear])) / scale
    variance = max(0.0, (explained - float(clear.sum())) / float(eigen[clear].sum()) * scale)
    declared = variance + (SMOOTH * width_px) ** 2
    return Misfit(variance**0.5, np.asarray((declared * response) @ response.T, np.float64))


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
