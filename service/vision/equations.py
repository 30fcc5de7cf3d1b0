"""Normal equations of a bundle, with the tubes' offsets eliminated (Schur complement)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.cholesky import inverse_factor, inverted, solved
from service.vision.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["LOST", "Equations", "assemble", "tube_variances"]

LOST = 1e4
"""Chi-square of a point that the lens model cannot place: no step leads there."""


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Normal equations of poses, camera and common unknowns, (P, P) and (P,), with the tubes' part beside them.

    `Y` (3J, P) and `y` (3J,) are what the tubes take away, whitened by `root` (J, 3, 3); `prior_chi2` is the part of
    `cost` that the priors have.
    """

    H: Array
    g: Array
    Y: Array
    y: Array
    root: Array
    cost: float
    prior_chi2: float

    def step(self, damping: float) -> Array:
        """Newton's step, damped."""
        S, scale = self._scaled(damping)
        return np.asarray(solved(S, (self.g - self.y @ self.Y) / scale) / scale)

    def covariance(self) -> Array:
        """(P, P) of poses, camera and common unknowns."""
        S, scale = self._scaled(0.0)
        return np.asarray(inverted(S) / np.outer(scale, scale))

    def _scaled(self, damping: float) -> tuple[Array, Array]:
        """The matrix without the tubes, scaled so that unlike unknowns compare; and that scale."""
        S = _without_tubes(self.H, self.Y)
        scale = np.sqrt(np.maximum(np.diag(S), 1e-300))
        S /= np.outer(scale, scale)
        S[np.diag_indices_from(S)] += damping + 1e-13
        return S, scale

    def offsets(self) -> Array:
        """Each tube's offset from its nominal place, (J, 3) mm."""
        return np.asarray(np.einsum("jpi,jp->ji", self.root, self.y.reshape(-1, 3)))


@compiled
def assemble(
    start: NDArray[np.int64], tube: NDArray[np.int64], residual: Array, J: Array, place: Array, shared: Array,
    cov: Array, weight: Array, noise: Array, tube_information: Array, free: NDArray[np.int64], H: Array, g: Array,
    Y: Array, y: Array, root: Array,
) -> float:  # fmt: skip
    """Add all centres up; gives their chi-square. `root` becomes the inverse of each tube's Cholesky factor.

    Rows of the tubes' part are whitened as they come, so their information is summed first.
    """
    info = np.empty((residual.shape[0], 3))
    chi2 = _information(start, residual, cov, weight, noise, info)
    _tube_factors(tube, place, info, tube_information, root)
    k = free.shape[0]
    width = 6 + k + shared.shape[2]
    B, at = np.empty((2, width)), np.empty(width, np.int64)
    at[6:] = np.arange(6 * (start.shape[0] - 1), H.shape[0])
    for f in range(start.shape[0] - 1):
        at[:6] = np.arange(6 * f, 6 * f + 6)
        for i in range(start[f], start[f + 1]):
            if info[i, 0] <= 0.0:
                continue
            for axis in range(2):
                B[axis, :6] = J[i, axis, :6]
                for p in range(k):
                    B[axis, 6 + p] = J[i, axis, 6 + free[p]]
                B[axis, 6 + k :] = shared[i, axis]
            _add(B, at, residual[i], info[i], place[i], root[tube[i]], 3 * tube[i], H, g, Y, y)
    for p in range(H.shape[0]):
        for q in range(p):
            H[p, q] = H[q, p]
    return chi2


@compiled
def _information(
    start: NDArray[np.int64], residual: Array, cov: Array, weight: Array, noise: Array, info: Array
) -> float:
    """Information of each centre, (N, 3) xx xy yy; gives the chi-square of all."""
    chi2 = 0.0
    for f in range(start.shape[0] - 1):
        for i in range(start[f], start[f + 1]):
            if math.isnan(residual[i, 0]):
                info[i] = 0.0
                chi2 += LOST
                continue
            w = weight[i] / ((cov[i, 0] * cov[i, 2] - cov[i, 1] * cov[i, 1]) * noise[f] * noise[f])
            xx, xy, yy = w * cov[i, 2], -w * cov[i, 1], w * cov[i, 0]
            info[i, 0], info[i, 1], info[i, 2] = xx, xy, yy
            x, y = residual[i]
            chi2 += xx * x * x + 2.0 * xy * x * y + yy * y * y
    return chi2


@compiled
def _tube_factors(tube: NDArray[np.int64], place: Array, info: Array, tube_information: Array, root: Array) -> None:
    """Inverse Cholesky factor of the information on each tube's offset, its prior's among it, (J, 3, 3)."""
    for j in range(root.shape[0]):
        root[j] = np.diag(tube_information[j])
    for i in range(tube.shape[0]):
        xx, xy, yy = info[i]
        T = place[i]
        for p in range(3):
            a, b = xx * T[0, p] + xy * T[1, p], xy * T[0, p] + yy * T[1, p]
            for q in range(3):
                root[tube[i], p, q] += a * T[0, q] + b * T[1, q]
    for j in range(root.shape[0]):
        root[j] = inverse_factor(root[j])


@compiled
def _add(
    B: Array, at: NDArray[np.int64], residual: Array, info: Array, T: Array, L: Array, j: int, H: Array, g: Array,
    Y: Array, y: Array,
) -> None:  # fmt: skip
    """Add one centre: `B` its derivatives by the unknowns `at`, `T` and `L` its tube's derivatives and root."""
    xx, xy, yy = info
    rx, ry = residual
    ex, ey = xx * rx + xy * ry, xy * rx + yy * ry
    M = np.empty((3, 2))  # whitened derivatives of the tube
    for p in range(3):
        M[p] = 0.0
        for q in range(p + 1):
            M[p, 0] += L[p, q] * T[0, q]
            M[p, 1] += L[p, q] * T[1, q]
        y[j + p] += M[p, 0] * ex + M[p, 1] * ey
    for p in range(at.shape[0]):
        wx, wy = xx * B[0, p] + xy * B[1, p], xy * B[0, p] + yy * B[1, p]
        g[at[p]] += wx * rx + wy * ry
        for q in range(p, at.shape[0]):
            H[at[p], at[q]] += wx * B[0, q] + wy * B[1, q]
        for r in range(3):
            Y[j + r, at[p]] += M[r, 0] * wx + M[r, 1] * wy


@compiled
def _without_tubes(H: Array, Y: Array) -> Array:
    """``H - Y.T @ Y``, of which each tube touches a few pictures only."""
    S, m = H.copy(), H.shape[0]
    seen = np.empty(m, np.int64)
    Z = np.empty((3, m))
    for j in range(0, Y.shape[0], 3):
        n = _gather(Y, j, seen, Z)
        for a in range(n):
            z0, z1, z2, row = Z[0, a], Z[1, a], Z[2, a], S[seen[a]]
            for b in range(a + 1):
                row[seen[b]] -= z0 * Z[0, b] + z1 * Z[1, b] + z2 * Z[2, b]
    for p in range(m):
        for q in range(p):
            S[q, p] = S[p, q]
    return S


@compiled
def _gather(Y: Array, j: int, seen: NDArray[np.int64], Z: Array) -> int:
    """Columns where the tube of rows j to j + 2 has anything, and what; how many they are."""
    n = 0
    for p in range(Y.shape[1]):
        if Y[j, p] != 0.0 or Y[j + 1, p] != 0.0 or Y[j + 2, p] != 0.0:
            seen[n] = p
            Z[0, n], Z[1, n], Z[2, n] = Y[j, p], Y[j + 1, p], Y[j + 2, p]
            n += 1
    return n


@compiled
def tube_variances(Y: Array, root: Array, C: Array) -> Array:
    """Variances of the tubes' offsets, (J, 3): ``diag(root.T @ (1 + Y C Y.T) @ root)`` for each."""
    m = Y.shape[1]
    seen, Z, inner, out = np.empty(m, np.int64), np.empty((3, m)), np.empty((3, 3)), np.empty((root.shape[0], 3))
    for j in range(root.shape[0]):
        n = _gather(Y, 3 * j, seen, Z)
        inner[:] = np.eye(3)
        for a in range(n):
            s0, s1, s2, row = 0.0, 0.0, 0.0, C[seen[a]]
            for b in range(n):
                c = row[seen[b]]
                s0 += c * Z[0, b]
                s1 += c * Z[1, b]
                s2 += c * Z[2, b]
            for p in range(3):
                inner[p, 0] += Z[p, a] * s0
                inner[p, 1] += Z[p, a] * s1
                inner[p, 2] += Z[p, a] * s2
        L = root[j]
        for i in range(3):
            out[j, i] = 0.0
            for p in range(3):
                for q in range(3):
                    out[j, i] += L[p, i] * inner[p, q] * L[q, i]
    return out
