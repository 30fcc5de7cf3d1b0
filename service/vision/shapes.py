"""What the grey values along a ray across a rim are made of, and how far each part of it is known beforehand.

Five shapes: a level; the picture's own mean edge profile `T`; what begins beyond the tube's wall, a blurred step; the
seam there, a bump; and ``-T'``, which is a shift.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled
from service.vision.edges import GRID, SAMPLES
from service.vision.rays import BASIS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.edges import EdgeProfile

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Shapes", "shapes_of"]

STRAY = np.array([0.05, 0.12, 0.25, 0.15, 0.04])
"""How far each shape strays from ray to ray: level, edge, what lies beyond the wall, seam, as parts of the edge's
height, and shift, px."""
LEAN = np.array([0.1, 0.09, 0.3, 0.12])
"""How far each but the shift leans to one side of the rim beside what is expected: one sigma of the cosine's and of the
sine's part."""
WITH_LIGHT = np.array([0.2, 1.1, 0.5, 0.0])
"""How each leans with the light, per relative change of the light from the tube's centre to its rim. Pictures tell it
themselves where it is left open: the edge by 1.0 to 1.4, as its height is read off outside of the rim; and the bore's
level by as much as it is of the edge's height."""
WITH_VIEW = np.array([0.2, 0.001, 1.0, 1.0])
"""How far each may lean with the view in all tubes alike, one sigma, per tangent of the angle of view: weld beads throw
the light back from the side that faces the lamp, and they, being raised, move with the view. The edge does not: where
that is left open it is taken for depth."""
HEIGHT = 0.2
"""How far a tube's edge differs from the height that its rays told one by one, as a part of it."""
BEYOND, SEAM = 1.0, 0.5
"""One sigma of how much brighter or darker it is beyond the wall, and at its seam."""
RADIUS_SIGMA = 9.0
"""How far, in edge widths, one tube's apparent radius strays from the picture's: as it likes."""
OUTER_DOUBT = 1.0
"""By how many times the noise samples are in doubt, per edge width beyond one: welds and neighbours begin there."""
LEAST_INFORMATION = 1e-9
"""Of the most: on large tubes the wall's outer edge lies beyond the samples, and its shapes are nothing."""
SEAM_IN, SEAM_WIDTH = 0.2, 0.8
"""How far inside the wall's outer edge its seam lies, and how wide it is, in edge widths."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """What a ray is made of, in terms in which both noise and straying are diagonal.

    With the shapes `B`, samples weighed by `W`, straying of covariance `S` and ``S^1/2 B^T W B S^1/2 = Q L Q^T``, the
    shapes ``B S^1/2 Q`` have the diagonal normal matrix `L` and stray by one each.

    Attributes
    ----------
    basis
        (BASIS, BASIS): ``S^1/2 Q`` takes coefficients in these terms to those of the shapes themselves.
    information
        (BASIS,) `L`, for noise of one grey value over one px.
    first
        (BASIS,) numbers of a ray that is one everywhere.
    edge, moved
        (BASIS,) what a ray's numbers above its bore are multiplied with for the height of its edge, by itself, and for
        that height times its shift.
    prior, expected
        (2, BASIS, BASIS) information on the means and on each of the leans, before a tube is looked at; (BASIS,) that
        of the means times what is expected.
    with_view, with_light
        (BASIS, BASIS) information on how all tubes lean together with the view, and (BASIS,) how they do with the
        light.
    """

    basis: NDArray[np.float64]
    information: NDArray[np.float64]
    first: NDArray[np.float64]
    edge: NDArray[np.float64]
    moved: NDArray[np.float64]
    prior: NDArray[np.float64]
    expected: NDArray[np.float64]
    with_view: NDArray[np.float64]
    with_light: NDArray[np.float64]


def shapes_of(profile: EdgeProfile, wall_px: float) -> tuple[NDArray[np.float32], Shapes]:
    """What samples are multiplied with, (BASIS + 1, SAMPLES), the last row for their squares; and in what terms.

    The wall's thickness counts in tenths of a px: a camera that hardly moves needs no others from picture to picture.
    """
    return _shapes_of(profile, round(wall_px, 1))


@lru_cache(maxsize=16)
def _shapes_of(profile: EdgeProfile, wall_px: float) -> tuple[NDArray[np.float32], Shapes]:
    means = np.array([np.inf, HEIGHT, BEYOND, SEAM, RADIUS_SIGMA * profile.width_px])
    functionals, terms = _in_own_terms(profile.template, profile.width_px, profile.position_px, wall_px, means**-2.0)
    return functionals, Shapes(*terms)


@compiled
def _in_own_terms(
    T: Array, width: float, position: float, wall_px: float, on_means: Array
) -> tuple[NDArray[np.float32], tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array]]:
    B, weight = _look_of_ray(T, width, position, wall_px)
    M = (B * weight) @ B.T
    information, Q = np.linalg.eigh(STRAY.reshape(-1, 1) * M * STRAY)
    information = np.maximum(information, LEAST_INFORMATION * information[-1])
    basis = STRAY.reshape(-1, 1) * Q
    functionals = np.empty((BASIS + 1, SAMPLES), np.float32)
    functionals[:BASIS] = (basis.T @ B) * weight
    functionals[BASIS] = weight
    det = M[1, 1] * M[4, 4] - M[1, 4] * M[1, 4]
    edge, moved = np.empty(BASIS), np.empty(BASIS)
    for p in range(BASIS):  # where a ray is nothing but its edge
        edge[p] = (M[4, 4] * Q[1, p] / STRAY[1] - M[1, 4] * Q[4, p] / STRAY[4]) / det
        moved[p] = (M[1, 1] * Q[4, p] / STRAY[4] - M[1, 4] * Q[1, p] / STRAY[1]) / det
    prior, with_view, with_light = np.zeros((2, BASIS, BASIS)), np.zeros((BASIS, BASIS)), np.zeros(BASIS)
    for k in range(BASIS):
        on_lean = LEAN[k] ** -2.0 if k < BASIS - 1 else 0.0
        on_view = WITH_VIEW[k] ** -2.0 if k < BASIS - 1 else on_means[k]
        for p in range(BASIS):
            with_light[p] += WITH_LIGHT[k] * Q[k, p] / STRAY[k] if k < BASIS - 1 else 0.0
            for q in range(BASIS):
                with_view[p, q] += on_view * basis[k, p] * basis[k, q]
                prior[0, p, q] += on_means[k] * basis[k, p] * basis[k, q]
                prior[1, p, q] += on_lean * basis[k, p] * basis[k, q]
    first = basis.T @ np.ascontiguousarray(M[:, 0])
    expected = basis[1] * on_means[1]
    return functionals, (basis, information, first, edge, moved, prior, expected, with_view, with_light)


@compiled
def _look_of_ray(T: Array, width: float, position: float, wall_px: float) -> tuple[Array, Array]:
    """The shapes, (BASIS, SAMPLES), and what each sample counts for, (SAMPLES,), for noise of one over one px."""
    B, weight = np.empty((BASIS, SAMPLES)), np.empty(SAMPLES)
    for j in range(SAMPLES):
        left, right = max(j - 1, 0), min(j + 1, SAMPLES - 1)
        span = GRID[right] - GRID[left]
        beyond = (position - wall_px) / width + GRID[j]
        B[0, j] = 1.0
        B[1, j] = T[j]
        B[2, j] = 0.5 * (1.0 + math.erf(beyond / math.sqrt(2.0)))
        B[3, j] = math.exp(-0.5 * ((beyond + SEAM_IN) / SEAM_WIDTH) ** 2)
        B[4, j] = -(T[right] - T[left]) / (width * span)
        doubt = OUTER_DOUBT * max(GRID[j] - 1.0, 0.0)
        weight[j] = width * span / (right - left) / (1.0 + doubt * doubt)
    return B, weight
