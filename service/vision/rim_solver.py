"""Solve for the rims of many tubes at once: what all grey values along a tube's rays say, by shapes that lean.

Unknowns are the mean, cosine's and sine's part of each of the `shapes`, fifteen a tube. A ray's samples have the
covariance ``s^2 W^-1 + B S B^T``: noise, and shapes that stray. In the terms of `Shapes`, what a ray's numbers tell of
its coefficients is then diagonal: ``L / (s^2 + L)``.

How far a tube's shapes are expected to lean is not nothing: with the light and with the view, as all tubes
of the picture tell it together.

The last axis of every array is the tubes', and each loop over it does one thing: so that a processor which adds and
multiplies many numbers at a time can. Sums are kept in single precision, as grey values are, equations in double.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.cholesky import solved
from service.vision.compiled import compiled, sort_columns
from service.vision.edges import SAMPLES
from service.vision.rays import BASIS, ENERGY
from service.vision.rim_levels import COVARIANCE, COVERED, HEIGHT, INNER_LEVEL, RADIUS, SHIFT, STRENGTH
from service.vision.scratch import DOUBLE, SINGLE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.rays import Rays
    from service.vision.scratch import Scratch
    from service.vision.shapes import Shapes

    Array: TypeAlias = NDArray[np.float64]
    Single: TypeAlias = NDArray[np.float32]

__all__ = ["solve"]

MODEL = 0.05
"""How well the shapes explain a sample one px long, as a part of the edge's height."""
LEAST_GAIN = 0.3
"""Least height of a tube's edge, of that which its rays told one by one, that a shift is told with."""
LEAST_AGREEING = 6.0
TELLING = 5.0
"""Least strength of a tube that tells how shapes lean with the view."""
LEAST_MISFIT = 0.03
"""A ray never fits better than this part of what noise and model say."""
SPREAD = 1.5
"""Errors over what the rays' own misfit tells, measured on truth: neighbouring rays see the same pixels, and shapes are
but alike."""
ROUNDS = 3
"""How often a tube is solved for; from the second time on, rays count by how well they fit."""
CUT = np.float32(9.0)
"""A ray that fits this many times worse than the usual one does not count."""
LEAST_USUAL = np.float32(1e-3)
SIZE = 3 * BASIS
MOMENT = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Which of the sums is the weight's moment by parts g and h: mean, cosine, sine."""
ONE, TWO, NOTHING = np.float32(1.0), np.float32(2.0), np.float32(0.0)
PER_SAMPLE = np.float32(1.0 / SAMPLES)


def solve(seen: Rays, shapes: Shapes, noise: float, view: Array, light: Array, told: Array, scratch: Scratch) -> None:
    """Shift, radius and covariance of each tube, into `told`, that of `rim_levels.levels`.

    Parameters
    ----------
    noise
        Error of a sample one px long, grey.
    view
        (2, n) where the picture shows a rim that lies deeper, per its depth: tangent of the angle that it is seen at.
    light
        (2, n) relative change of the light from the tube's centre to its rim.
    scratch
        Lends the memory for the equations.
    """
    count, n = seen.valid.shape
    _solve(
        seen.numbers, seen.direction, seen.valid, shapes.first, shapes.information, shapes.basis, shapes.prior,
        shapes.expected, shapes.with_view, shapes.with_light, noise, view, light, told,
        scratch.array((BASIS, count, n), SINGLE), scratch.array((3, count, n), SINGLE),
        scratch.array((SIZE, SIZE, n), DOUBLE),
    )  # fmt: skip


@compiled
def _solve(
    numbers: Single, direction: Single, valid: Single, first: Array, information: Array, basis: Array, prior: Array,
    expected: Array, with_view: Array, with_light: Array, noise: float, view: Array, light: Array, told: Array,
    z: Single, of_rays: Single, A: Array,
) -> None:  # fmt: skip
    count, n = valid.shape
    precision, usual = np.empty(n, np.float32), np.empty(n, np.float32)
    straying, counted = np.empty((BASIS, n), np.float32), np.empty((BASIS, n), np.float32)
    energy, weight, misfit = of_rays[0], of_rays[1], of_rays[2]
    weight[:] = valid
    sums, x = np.empty((6 + SIZE, n), np.float32), np.empty((SIZE, n))
    _in_edge_heights(numbers, first, information, noise, told, precision, straying, counted, z, energy)
    for step in range(ROUNDS):
        _sum(direction, weight, z, sums)
        lean = _lean_with_view(sums, counted, straying, with_view, with_light, view, light, told[STRENGTH])
        _equations(sums, counted, straying, prior, expected, prior[1] @ lean, prior[1] @ with_light, view, light, A, x)
        _factor(A)
        _substitute(A, x)
        if step < ROUNDS - 1:
            _misfits(direction, z, energy, information, straying, precision, x, misfit)
            _reweigh(valid, misfit, weight, usual)
    _tell(count, sums[0], usual, basis, A, x, told)


@compiled
def _in_edge_heights(
    numbers: Single, first: Array, information: Array, noise: float, told: Array, precision: Single, straying: Single,
    counted: Single, z: Single, energy: Single,
) -> None:  # fmt: skip
    """Numbers above the bore in parts of the edge's height, `z`, and squares, `energy`; what they count for."""
    count, n = energy.shape
    inverse, bore = np.empty(n, np.float32), np.empty(n, np.float32)
    for i in range(n):
        height = told[HEIGHT, i] if told[HEIGHT, i] > 0.0 else 1.0
        inverse[i], bore[i] = 1.0 / height, told[INNER_LEVEL, i]
        precision[i] = 1.0 / ((noise / height) ** 2 + MODEL * MODEL)
    of_one = np.float32(np.sum(first * first / information))  # energy of a ray that is one everywhere
    share = (first / information).astype(np.float32)
    f0, f1, f2, f3, f4 = share[0], share[1], share[2], share[3], share[4]
    for p in range(BASIS):
        known, one = np.float32(information[p]), np.float32(first[p])
        for i in range(n):
            straying[p, i] = precision[i] / (ONE + precision[i] * known)
            counted[p, i] = straying[p, i] * known
        for k in range(count):
            for i in range(n):
                z[p, k, i] = (numbers[p, k, i] - bore[i] * one) * inverse[i]
    for k in range(count):
        for i in range(n):
            above = (
                f0 * numbers[0, k, i] + f1 * numbers[1, k, i] + f2 * numbers[2, k, i] + f3 * numbers[3, k, i]
                + f4 * numbers[4, k, i]
            )  # fmt: skip
            energy[k, i] = (numbers[ENERGY, k, i] - bore[i] * (TWO * above - bore[i] * of_one)) * inverse[i] ** 2


@compiled
def _sum(direction: Single, weight: Single, z: Single, sums: Single) -> None:
    """Sums over the rays of w, w ux, w uy, w ux ux, w ux uy, w uy uy, then of w z (1, ux, uy); four rays at a time."""
    sums[:] = NOTHING
    for k in range(0, weight.shape[0], 4):
        w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        x0, x1, x2, x3 = direction[0, k], direction[0, k + 1], direction[0, k + 2], direction[0, k + 3]
        y0, y1, y2, y3 = direction[1, k], direction[1, k + 1], direction[1, k + 2], direction[1, k + 3]
        for i in range(weight.shape[1]):
            sums[0, i] += w0[i] + w1[i] + w2[i] + w3[i]
            sums[1, i] += w0[i] * x0[i] + w1[i] * x1[i] + w2[i] * x2[i] + w3[i] * x3[i]
            sums[2, i] += w0[i] * y0[i] + w1[i] * y1[i] + w2[i] * y2[i] + w3[i] * y3[i]
            sums[3, i] += w0[i] * x0[i] * x0[i] + w1[i] * x1[i] * x1[i] + w2[i] * x2[i] * x2[i] + w3[i] * x3[i] * x3[i]
            sums[4, i] += w0[i] * x0[i] * y0[i] + w1[i] * x1[i] * y1[i] + w2[i] * x2[i] * y2[i] + w3[i] * x3[i] * y3[i]
            sums[5, i] += w0[i] * y0[i] * y0[i] + w1[i] * y1[i] * y1[i] + w2[i] * y2[i] * y2[i] + w3[i] * y3[i] * y3[i]
        for p in range(BASIS):
            z0, z1, z2, z3 = z[p, k], z[p, k + 1], z[p, k + 2], z[p, k + 3]
            mean, cosine, sine = sums[6 + p], sums[6 + BASIS + p], sums[6 + 2 * BASIS + p]
            for i in range(weight.shape[1]):
                a, b, c, d = w0[i] * z0[i], w1[i] * z1[i], w2[i] * z2[i], w3[i] * z3[i]
                mean[i] += a + b + c + d
                cosine[i] += a * x0[i] + b * x1[i] + c * x2[i] + d * x3[i]
                sine[i] += a * y0[i] + b * y1[i] + c * y2[i] + d * y3[i]


@compiled
def _lean_with_view(
    sums: Single, counted: Single, straying: Single, prior: Array, with_light: Array, view: Array, light: Array,
    strength: Array,
) -> Array:  # fmt: skip
    """How the shapes of all tubes lean with the view, (BASIS,), beside what they do with the light.

    Where each tube's means and shift are as they like, sums of the first harmonics over all tubes tell it; `prior` is
    the information on it beforehand.
    """
    A, b = prior.copy(), np.zeros(BASIS)
    for i in range(sums.shape[1]):
        if strength[i] < TELLING or sums[0, i] < LEAST_AGREEING:
            continue
        x, y = view[0, i], view[1, i]
        total, cosine, sine = sums[0, i], sums[1, i], sums[2, i]
        middle = (x * cosine + y * sine) / total
        to_x = x * sums[3, i] + y * sums[4, i] - middle * cosine
        to_y = x * sums[4, i] + y * sums[5, i] - middle * sine
        of_view, of_light = x * to_x + y * to_y, light[0, i] * to_x + light[1, i] * to_y
        for p in range(BASIS):
            leans = x * sums[6 + BASIS + p, i] + y * sums[6 + 2 * BASIS + p, i] - middle * sums[6 + p, i]
            A[p, p] += counted[p, i] * of_view
            b[p] += straying[p, i] * leans - counted[p, i] * of_light * with_light[p]
    return solved(A, b)


@compiled
def _equations(
    sums: Single, counted: Single, straying: Single, prior: Array, expected: Array, by_view: Array, by_light: Array,
    view: Array, light: Array, A: Array, x: Array,
) -> None:  # fmt: skip
    """Normal equations, the lower halves of (SIZE, SIZE, n), and their right sides into `x`."""
    n = sums.shape[1]
    for p in range(BASIS):
        for i in range(n):
            x[p, i] = sums[6 + p, i] * straying[p, i] + expected[p]
        for h in (1, 2):
            for i in range(n):
                of_rays = sums[6 + h * BASIS + p, i] * straying[p, i]
                x[h * BASIS + p, i] = of_rays + by_view[p] * view[h - 1, i] + by_light[p] * light[h - 1, i]
        for h in range(3):
            for g in range(h + 1):
                for q in range(BASIS):
                    A[h * BASIS + p, g * BASIS + q] = prior[min(h, 1), p, q] if g == h else 0.0
                for i in range(n):
                    A[h * BASIS + p, g * BASIS + p, i] += counted[p, i] * sums[MOMENT[h, g], i]


@compiled
def _factor(A: Array) -> None:
    """Cholesky's factors in place of the lower halves, their diagonals inverted; NaN where one is not positive."""
    n = A.shape[2]
    for p in range(SIZE):
        for q in range(p + 1):
            for r in range(0, q - 1, 2):
                for i in range(n):
                    A[p, q, i] -= A[p, r, i] * A[q, r, i] + A[p, r + 1, i] * A[q, r + 1, i]
            if q % 2 == 1:
                for i in range(n):
                    A[p, q, i] -= A[p, q - 1, i] * A[q, q - 1, i]
            if q < p:
                for i in range(n):
                    A[p, q, i] *= A[q, q, i]
            else:
                for i in range(n):
                    A[p, p, i] = 1.0 / math.sqrt(A[p, p, i])  # inverse: divisions are slow


@compiled
def _substitute(L: Array, x: Array) -> None:
    """Solve ``L L^T x = x`` in place."""
    _forward(L, x, 0)
    for p in range(SIZE - 1, -1, -1):
        for q in range(p + 1, SIZE):
            for i in range(x.shape[1]):
                x[p, i] -= L[q, p, i] * x[q, i]
        for i in range(x.shape[1]):
            x[p, i] *= L[p, p, i]


@compiled
def _forward(L: Array, x: Array, begin: int) -> None:
    """Solve ``L x = x`` in place; the rows before `begin` are zeros."""
    for p in range(begin, SIZE):
        for q in range(begin, p):
            for i in range(x.shape[1]):
                x[p, i] -= L[p, q, i] * x[q, i]
        for i in range(x.shape[1]):
            x[p, i] *= L[p, p, i]


@compiled
def _misfits(
    direction: Single, z: Single, energy: Single, information: Array, straying: Single, precision: Single, x: Array,
    misfit: Single,
) -> None:  # fmt: skip
    """How badly each ray fits, chi-square a sample: what neither its coefficients nor their straying explain."""
    count, n = misfit.shape
    share, rest = np.empty(n, np.float32), np.empty(n, np.float32)
    single = x.astype(np.float32)
    for k in range(count):
        for i in range(n):
            misfit[k, i] = energy[k, i]
        for p in range(BASIS):
            known = np.float32(information[p])
            mean, cosine, sine = single[p], single[BASIS + p], single[2 * BASIS + p]
            for i in range(n):
                share[i] = mean[i] + direction[0, k, i] * cosine[i] + direction[1, k, i] * sine[i]
            for i in range(n):
                rest[i] = z[p, k, i] - known * share[i]
            for i in range(n):
                misfit[k, i] -= share[i] * (z[p, k, i] + rest[i]) + straying[p, i] * rest[i] * rest[i]
        for i in range(n):
            misfit[k, i] *= precision[i] * PER_SAMPLE


@compiled
def _reweigh(valid: Single, misfit: Single, weight: Single, usual: Single) -> None:
    """Weigh each ray by how well it fits, beside the usual one of its tube: the median."""
    count, n = valid.shape
    rays = np.zeros(n)
    for k in range(count):
        for i in range(n):
            rays[i] += valid[k, i]
            weight[k, i] = misfit[k, i] if valid[k, i] > NOTHING else np.float32(np.inf)
    sort_columns(weight)
    for i in range(n):
        usual[i] = max(weight[min(int(rays[i]) // 2, count - 1), i], LEAST_USUAL)
    for k in range(count):
        for i in range(n):
            weight[k, i] = valid[k, i] * max(ONE - misfit[k, i] / (CUT * usual[i]), NOTHING)


@compiled
def _tell(count: int, agreeing: Single, usual: Single, basis: Array, L: Array, x: Array, told: Array) -> None:
    """What tubes are told from their coefficients; L holds Cholesky's factors."""
    n, last = agreeing.shape[0], BASIS - 1
    root = np.zeros((2, SIZE, n))
    for h in range(2):
        for p in range(BASIS):
            root[h, (h + 1) * BASIS + p] = basis[last, p]
        _forward(L, root[h], (h + 1) * BASIS)
    part = np.zeros((2, 3, n))  # mean, cosine's and sine's part of the edge's height and of the shift
    for g in range(2):
        for h in range(3):
            for p in range(BASIS):
                factor = basis[1 if g == 0 else last, p]
                for i in range(n):
                    part[g, h, i] += factor * x[h * BASIS + p, i]
    for i in range(n):
        if told[COVERED, i] == 0.0 or told[HEIGHT, i] <= 0.0:
            continue
        xx, xy, yy = 0.0, 0.0, 0.0
        for p in range(BASIS, SIZE):
            xx += root[0, p, i] * root[0, p, i]
            xy += root[0, p, i] * root[1, p, i]
            yy += root[1, p, i] * root[1, p, i]
        told[COVERED, i] = agreeing[i] / count
        if agreeing[i] < LEAST_AGREEING or not xx > 0.0 or not yy > 0.0:
            told[STRENGTH, i] = -1.0
            continue
        height = max(part[0, 0, i], LEAST_GAIN)
        radius = part[1, 0, i] / height
        told[RADIUS, i] = radius
        for h in range(2):
            told[SHIFT + h, i] = (part[1, 1 + h, i] - part[0, 1 + h, i] * radius) / height
        excess = max(usual[i], LEAST_MISFIT) * SPREAD * SPREAD
        told[COVARIANCE, i], told[COVARIANCE + 1, i], told[COVARIANCE + 2, i] = xx * excess, xy * excess, yy * excess
