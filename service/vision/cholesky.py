"""Cholesky's factorisation for kernels: by rows, as BLAS's threads would fight for the cores with those that grab."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["inverse_factor", "inverted", "solved"]


@compiled
def inverse_factor(A: Array) -> Array:
    """Inverse of the lower Cholesky factor of a positive matrix, (3, 3)."""
    a = math.sqrt(A[0, 0])
    b, d = A[1, 0] / a, A[2, 0] / a
    c = math.sqrt(A[1, 1] - b * b)
    e = (A[2, 1] - d * b) / c
    f = math.sqrt(A[2, 2] - d * d - e * e)
    out = np.zeros((3, 3))
    out[0, 0], out[1, 1], out[2, 2] = 1.0 / a, 1.0 / c, 1.0 / f
    out[1, 0], out[2, 1] = -b / (a * c), -e / (c * f)
    out[2, 0] = (b * e / c - d) / (a * f)
    return out


@compiled
def _factor(A: Array) -> None:
    """Cholesky's factor in the place of the lower triangle."""
    for i in range(A.shape[0]):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total / A[j, j] if j < i else math.sqrt(max(total, 1e-30))


@compiled
def solved(A: Array, b: Array) -> Array:
    """Solve ``A x = b`` for a positive matrix, which is lost."""
    _factor(A)
    x = b.copy()
    for i in range(len(x)):
        for k in range(i):
            x[i] -= A[i, k] * x[k]
        x[i] /= A[i, i]
    for i in range(len(x) - 1, -1, -1):
        x[i] /= A[i, i]
        for k in range(i):
            x[k] -= A[i, k] * x[i]
    return x


@compiled
def inverted(A: Array) -> Array:
    """Inverse of a positive matrix, which is lost."""
    _factor(A)
    m = A.shape[0]
    Z = np.zeros((m, m))  # row i: column i of the factor's inverse
    for i in range(m):
        Z[i, i] = 1.0 / A[i, i]
        for r in range(i + 1, m):
            total = 0.0
            for k in range(i, r):
                total += A[r, k] * Z[i, k]
            Z[i, r] = -total / A[r, r]
    out = np.empty((m, m))
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, m):
                total += Z[i, k] * Z[j, k]
            out[i, j] = out[j, i] = total
    return out
