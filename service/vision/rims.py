"""Measure tube ends along the normals of their projected rims.

A tube end is a circle in the sheet. Its picture under a known pose is sampled along the normals of the *projected
circle*, so there is no ellipse-centre bias; what is left to find is how far the true rim lies from the predicted one:
a shift ``(dx, dy)`` of the tube and, as a nuisance, a change ``dr`` of the apparent radius (weld ring, blur).

All grey values along a tube's rays are explained at once, by the five `shapes`: a level, the picture's own mean edge
profile, what begins beyond the tube's wall, the seam there, and a shift. Each shape's share changes around the rim as
``a + b cos + c sin``: light falls unevenly on bore, tube end and plate, each in its own way, and what is not allowed to
is taken for a shift. The shift's own three are dr, dx and dy. How far the shares stray, around the rim and from ray to
ray, is known beforehand, which makes the solution a linear one with a covariance; rays that do not fit are then
weighed down (hose, glint, speck) and it is solved again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import clipped_mean, compiled, median_in_place
from service.vision.edges import SAMPLES, profile_of
from service.vision.light import SLOPE_REACH, light_slopes
from service.vision.rays import BASIS, BORE, ENERGY, NOISE, NUMBERS, OUTSIDE, circle_of, rays_for, sample_rays
from service.vision.shapes import shapes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.edges import EdgeProfile
    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Rims", "measure_rims"]

LIGHT_SHIFT, LIGHT_BLUR, SHARP_PX = 0.15, 1.0, 0.8
"""What uneven light shifts a rim by, in `Rims.light_px`: on sharp pictures, and more per px of blur beyond SHARP_PX.
Measured on truth."""
MODEL = 0.05
"""How well the shapes explain a sample one px long, as a part of the edge's height."""
NOISE_SCALE = 2.0
"""Error of a sample one px long over the grey values' second difference in the bore."""
LEAST_RAYS = 8
"""Fewer rays in the picture tell nothing of a tube."""
LEAST_GAIN = 0.3
"""Least height of a tube's edge, of that which its rays told one by one, that a shift is told with."""
LEAST_RAY_GAIN = 0.12
"""A ray whose gain falls below this share of the tube's shows no edge."""
REACH = 1.6
"""Largest shift of a ray, in edge widths, that the linear model serves."""
LEAST_RAY_SIGMA = 0.05
"""A ray is never better than this, px: the template is not exact."""
SHARED = 1.4
"""Neighbouring rays see the same pixels: their common error counts once, measured on truth."""
LEAST_AGREEING = 6.0
LEAST_MISFIT = 0.03
"""A ray never fits better than this part of what noise and model say."""
SPREAD = 1.5
"""Errors over what the rays' own misfit tells, measured on truth: neighbouring rays see the same pixels, and shapes are
but alike."""
ROUNDS = 3
"""How often a tube is solved for; from the second time on, rays count by how well they fit."""
CUT = 9.0
"""A ray that fits this many times worse than the usual one does not count."""
SIZE = 3 * BASIS
LANES = 8
"""Tubes that are solved side by side."""


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """What the rims at n predicted places showed, in the order asked for.

    Attributes
    ----------
    center_px
        (n, 2) measured centre of each tube-end circle's projection; that predicted, where there is none.
    shift_px
        (n, 2) how far it lies from where it was predicted.
    radius_px
        (n,) change of the apparent radius against the profile's.
    covariance_px
        (n, 3) xx, xy, yy of the centre.
    gain, bore, outside
        (n,) grey: height of the edge, level in the bore, level at the rays' outer ends.
    strength
        (n,) height of the edge over its uncertainty, as the rays tell it; negative where nothing could be measured.
    rays
        (n,) share of the rays that take part.
    light_px
        (n, 2) edge width times the relative change of the light from the tube's centre to its rim: what uneven light
        may shift a rim by.
    mean
        (n, SAMPLES) mean profile of each tube's rays.
    looked
        The edge that placed the samples.
    """

    center_px: NDArray[np.float64]
    shift_px: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    covariance_px: NDArray[np.float64]
    gain: NDArray[np.float64]
    bore: NDArray[np.float64]
    outside: NDArray[np.float64]
    strength: NDArray[np.float64]
    rays: NDArray[np.float64]
    light_px: NDArray[np.float64]
    mean: NDArray[np.float64]
    looked: EdgeProfile

    def profile(self) -> EdgeProfile | None:
        """The mean edge of the clearest tubes; None where too few show one."""
        return profile_of(self.mean, self.bore, self.gain, self.strength, self.rays, self.looked)


def measure_rims(
    image: Image,
    vector: Array,
    rotation: Array,
    translation_mm: Array,
    sheet_mm: Array,
    lattice: Lattice,
    profile: EdgeProfile,
    rays: int | None = None,
) -> Rims:
    """Measure the tubes at `sheet_mm`, (n, 2) nominal places, n >= 1, predicted to within an edge width or two.

    Parameters
    ----------
    image
        (h, w) grey, C-contiguous.
    vector, rotation, translation_mm
        Intrinsics (`camera.lens_vector`) and predicted pose.
    profile
        Where and how wide the edge is expected.
    rays
        Rays a tube; by default as many as the rim's size deserves.
    """
    n, aspect = len(sheet_mm), float(vector[0] / vector[1])
    scale = _px_per_mm(vector, rotation, translation_mm, sheet_mm)
    count = rays or rays_for(2 * math.pi * lattice.rim_radius_mm * scale)
    wall_px = (lattice.outer_radius_mm - lattice.rim_radius_mm) * scale
    functionals, shapes = shapes_of(profile, wall_px)
    numbers, direction = np.empty((n, count, NUMBERS), np.float32), np.empty((n, count, 2), np.float32)
    valid, mean = np.empty((n, count), np.bool_), np.empty((n, SAMPLES))
    center, level, out = np.empty((n, 2)), np.zeros(n), np.zeros((n, 11))
    sample_rays(
        image, vector, rotation, translation_mm, sheet_mm, lattice.rim_radius_mm, circle_of(count), profile.offsets_px,
        functionals, numbers, direction, center, valid, mean, level,
    )  # fmt: skip
    noise = _levels_of(numbers, valid, shapes.first, shapes.edge, out)
    if profile.learnt:
        _solve(
            numbers, direction, valid, shapes.first, shapes.information, shapes.basis, shapes.prior, shapes.expected,
            noise * NOISE_SCALE, out,
        )  # fmt: skip
    else:
        _find(numbers, direction, valid, shapes.first, shapes.edge, shapes.moved, REACH * profile.width_px, out)
    out[:, 1] /= aspect
    slope = np.zeros((n, 2))
    light_slopes(
        center, aspect, out[:, 5].copy(), out[:, 8].copy(), SLOPE_REACH * lattice.pitch_mm * scale,
        lattice.rim_radius_mm * scale, slope,
    )  # fmt: skip
    light = slope * [profile.width_px, profile.width_px / aspect]
    shift = out[:, 0:2] + (LIGHT_SHIFT + LIGHT_BLUR * max(0.0, profile.width_px - SHARP_PX)) * light
    return Rims(
        center_px=center + shift, shift_px=shift, radius_px=out[:, 10],
        covariance_px=out[:, 2:5] / [1.0, aspect, aspect * aspect], gain=out[:, 5], bore=out[:, 6] + level,
        outside=out[:, 7] + level, strength=out[:, 8], rays=out[:, 9], light_px=light, mean=mean, looked=profile,
    )  # fmt: skip


def _px_per_mm(vector: Array, rotation: Array, translation_mm: Array, sheet_mm: Array) -> float:
    """Scale in the middle of the places, px per mm."""
    middle = sheet_mm.mean(axis=0)
    depth = rotation[2, 0] * middle[0] + rotation[2, 1] * middle[1] + translation_mm[2]
    return math.sqrt(vector[0] * vector[1]) / max(float(depth), 1e-6)


@compiled
def _levels_of(numbers: NDArray[np.float32], valid: NDArray[np.bool_], first: Array, edge: Array, out: Array) -> float:
    """Levels, height of the edge and strength of each tube, into `out`; gives the noise of a grey value.

    The columns of `out` are those of `Rims`: shift x, y; covariance xx, xy, yy; gain, bore, outside, strength, rays,
    radius; lengths in px of x.
    """
    count = numbers.shape[1]
    work, noises, told = np.empty(count), np.empty(numbers.shape[0]), 0
    of_one = 0.0
    for p in range(BASIS):
        of_one += edge[p] * first[p]
    for i in range(numbers.shape[0]):
        o = out[i]
        o[8] = -1.0
        n = 0
        for k in range(count):
            if valid[i, k]:
                work[n] = numbers[i, k, BORE]
                n += 1
        if n < LEAST_RAYS:
            continue
        bore, _ = clipped_mean(work, n)
        n = 0
        for k in range(count):
            if valid[i, k]:
                work[n] = numbers[i, k, OUTSIDE]
                n += 1
        outside, _ = clipped_mean(work, n)
        n = 0
        for k in range(count):
            if valid[i, k]:
                work[n] = _dot(edge, numbers[i, k]) - bore * of_one
                n += 1
        gain, stray = clipped_mean(work, n)
        n = 0
        for k in range(count):
            if valid[i, k]:
                work[n] = abs(numbers[i, k, NOISE])
                n += 1
        noises[told] = median_in_place(work, n)
        told += 1
        o[5], o[6], o[7] = gain, bore, outside
        o[8] = gain * math.sqrt(n) / (1.25 * stray + 1e-6)
        o[9] = n / count
    return 1.4826 / math.sqrt(6.0) * median_in_place(noises, told) + 0.3 if told else 1.0


@compiled
def _dot(a: Array, numbers: NDArray[np.float32]) -> float:
    y = 0.0
    for p in range(BASIS):
        y += a[p] * numbers[p]
    return y


@compiled
def _solve(
    numbers: NDArray[np.float32], direction: NDArray[np.float32], valid: NDArray[np.bool_], first: Array,
    information: Array, basis: Array, prior: Array, expected: Array, noise: float, out: Array,
) -> None:  # fmt: skip
    """Shift, radius and covariance of each tube, into `out`, which holds the levels already.

    A ray's samples have the covariance ``s^2 W^-1 + B S B^T``: noise, and shapes that stray. In the terms of `Shapes`,
    what a ray's numbers tell of its coefficients is then diagonal: ``L / (s^2 + L)``. LANES tubes are solved side by
    side, as a processor adds and multiplies several at a time.
    """
    count = numbers.shape[1]
    weight, z = np.empty((LANES, count)), np.empty((LANES, count, BASIS))
    counted, told = np.empty((LANES, BASIS)), np.empty((LANES, BASIS))
    usual, agreeing, precision = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    A, rhs, x = np.empty((SIZE, SIZE, LANES)), np.empty((SIZE, LANES)), np.empty((SIZE, LANES))
    tube = np.empty(LANES, np.int64)
    i = 0
    while i < numbers.shape[0]:
        lanes = 0
        while lanes < LANES and i < numbers.shape[0]:
            if out[i, 5] > 0.0 and out[i, 9] > 0.0:
                tube[lanes] = i
                precision[lanes] = 1.0 / ((noise / out[i, 5]) ** 2 + MODEL * MODEL)
                for p in range(BASIS):
                    told[lanes, p] = precision[lanes] / (1.0 + precision[lanes] * information[p])
                    counted[lanes, p] = told[lanes, p] * information[p]
                for k in range(count):
                    weight[lanes, k] = 1.0 if valid[i, k] else 0.0
                    for p in range(BASIS):
                        z[lanes, k, p] = (numbers[i, k, p] - out[i, 6] * first[p]) / out[i, 5]
                lanes += 1
            i += 1
        if lanes == 0:
            break
        for step in range(ROUNDS):
            for lane in range(LANES):
                of = min(lane, lanes - 1)  # spare lanes go along with the last
                agreeing[lane] = _equations(
                    direction[tube[of]], weight[of], z[of], counted[of], told[of], prior, expected, A, rhs, lane
                )
            _factor(A)
            _substitute(A, rhs, x)
            if step == ROUNDS - 1:
                break
            for lane in range(lanes):
                j = tube[lane]
                if agreeing[lane] >= LEAST_AGREEING:
                    usual[lane] = _reweigh(
                        numbers[j], direction[j], valid[j], z[lane], out[j, 5], out[j, 6], first, information,
                        told[lane], precision[lane], x[:, lane], weight[lane],
                    )  # fmt: skip
        _tell(tube[:lanes], count, agreeing, usual, basis, A, x, out)


@compiled
def _equations(
    direction: NDArray[np.float32], weight: Array, z: Array, counted: Array, told: Array, prior: Array, expected: Array,
    A: Array, rhs: Array, lane: int,
) -> float:  # fmt: skip
    """Normal equations of one tube, lower half; unknowns are means, cosines and sines of each shape. Sum of weights."""
    s, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for p in range(SIZE):
        rhs[p, lane] = 0.0
    for k in range(weight.shape[0]):
        w = weight[k]
        if w <= 0.0:
            continue
        ux, uy = direction[k, 0], direction[k, 1]
        s += w
        sx += w * ux
        sy += w * uy
        sxx += w * ux * ux
        sxy += w * ux * uy
        syy += w * uy * uy
        for p in range(BASIS):
            y = w * z[k, p]
            rhs[p, lane] += y
            rhs[BASIS + p, lane] += y * ux
            rhs[2 * BASIS + p, lane] += y * uy
    for p in range(BASIS):
        for q in range(BASIS):
            A[p, q, lane] = prior[0, p, q]
            A[BASIS + p, BASIS + q, lane] = prior[1, p, q]
            A[2 * BASIS + p, 2 * BASIS + q, lane] = prior[1, p, q]
            A[BASIS + p, q, lane] = 0.0
            A[2 * BASIS + p, q, lane] = 0.0
            A[2 * BASIS + p, BASIS + q, lane] = 0.0
        A[p, p, lane] += counted[p] * s
        A[BASIS + p, p, lane] = counted[p] * sx
        A[2 * BASIS + p, p, lane] = counted[p] * sy
        A[BASIS + p, BASIS + p, lane] += counted[p] * sxx
        A[2 * BASIS + p, BASIS + p, lane] = counted[p] * sxy
        A[2 * BASIS + p, 2 * BASIS + p, lane] += counted[p] * syy
        for h in range(3):
            rhs[h * BASIS + p, lane] *= told[p]
        rhs[p, lane] += expected[p]
    return s


@compiled
def _reweigh(
    numbers: NDArray[np.float32], direction: NDArray[np.float32], valid: NDArray[np.bool_], z: Array, gain: float,
    bore: float, first: Array, information: Array, told: Array, precision: float, x: Array, weight: Array,
) -> float:  # fmt: skip
    """Weigh each ray by how well it fits, `weight`; gives how badly the usual one does, chi-square a sample."""
    count = weight.shape[0]
    misfit, work, n = np.empty(count), np.empty(count), 0
    of_one = 0.0  # energy of a ray that is one everywhere
    for p in range(BASIS):
        of_one += first[p] * first[p] / information[p]
    for k in range(count):
        if not valid[k]:
            continue
        ux, uy = direction[k, 0], direction[k, 1]
        square, above = numbers[k, ENERGY], 0.0
        for p in range(BASIS):
            above += first[p] / information[p] * numbers[k, p]
        square = (square - bore * (2.0 * above - bore * of_one)) / (gain * gain)
        explained = 0.0
        for p in range(BASIS):
            share = x[p] + ux * x[BASIS + p] + uy * x[2 * BASIS + p]
            rest = z[k, p] - information[p] * share
            square -= share * (z[k, p] + rest)
            explained += told[p] * rest * rest  # by straying
        misfit[k] = precision * (square - explained) / SAMPLES
        work[n] = misfit[k]
        n += 1
    usual = max(median_in_place(work, n), 1e-3)
    for k in range(count):
        if valid[k]:
            weight[k] = max(1.0 - misfit[k] / (CUT * usual), 0.0)
        else:
            weight[k] = 0.0
    return usual


@compiled
def _tell(
    tube: NDArray[np.int64], count: int, agreeing: Array, usual: Array, basis: Array, A: Array, x: Array, out: Array
) -> None:  # fmt: skip
    """What tubes are told from their coefficients, into `out`; A holds Cholesky's factors."""
    last = BASIS - 1
    lever, root = np.zeros((2, SIZE, LANES)), np.empty((2, SIZE, LANES))
    for p in range(BASIS):
        lever[0, BASIS + p], lever[1, 2 * BASIS + p] = basis[last, p], basis[last, p]
    for h in range(2):
        _forward(A, lever[h], root[h])
    for lane in range(tube.shape[0]):
        o = out[tube[lane]]
        o[9] = agreeing[lane] / count
        height, lean_x, lean_y, radius, dx, dy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for p in range(BASIS):
            height += basis[1, p] * x[p, lane]
            lean_x += basis[1, p] * x[BASIS + p, lane]
            lean_y += basis[1, p] * x[2 * BASIS + p, lane]
            radius += basis[last, p] * x[p, lane]
            dx += basis[last, p] * x[BASIS + p, lane]
            dy += basis[last, p] * x[2 * BASIS + p, lane]
        xx, xy, yy = 0.0, 0.0, 0.0
        for p in range(SIZE):
            xx += root[0, p, lane] * root[0, p, lane]
            xy += root[0, p, lane] * root[1, p, lane]
            yy += root[1, p, lane] * root[1, p, lane]
        if agreeing[lane] < LEAST_AGREEING or not xx > 0.0 or not yy > 0.0:
            o[8] = -1.0
            continue
        height = max(height, LEAST_GAIN)
        o[10] = radius / height
        o[0], o[1] = (dx - lean_x * o[10]) / height, (dy - lean_y * o[10]) / height
        excess = max(usual[lane], LEAST_MISFIT) * SPREAD * SPREAD
        o[2], o[3], o[4] = xx * excess, xy * excess, yy * excess


@compiled
def _find(
    numbers: NDArray[np.float32], direction: NDArray[np.float32], valid: NDArray[np.bool_], first: Array, edge: Array,
    moved: Array, reach: float, out: Array,
) -> None:  # fmt: skip
    """Shift, radius and covariance of each tube whose edge may lie far off, ray by ray, into `out`."""
    count = numbers.shape[1]
    of_one, shift_of_one = 0.0, 0.0
    for p in range(BASIS):
        of_one += edge[p] * first[p]
        shift_of_one += moved[p] * first[p]
    work, shift, weight = np.empty(count), np.empty(count), np.empty(count)
    for i in range(numbers.shape[0]):
        o = out[i]
        gain, bore = o[5], o[6]
        if gain <= 0.0 or o[9] == 0.0:
            continue
        for k in range(count):  # brighter rays count more, up to a limit
            weight[k] = 0.0
            if not valid[i, k]:
                continue
            g = _dot(edge, numbers[i, k]) - bore * of_one
            gs = _dot(moved, numbers[i, k]) - bore * shift_of_one
            if g > LEAST_RAY_GAIN * gain and abs(gs) < reach * g:
                shift[k] = gs / g
                weight[k] = min(g / gain, 1.5) ** 2
        if not _circle_fit(direction[i], shift, weight, work, o):
            o[8] = -1.0


@compiled
def _circle_fit(direction: NDArray[np.float32], shift: Array, weight: Array, work: Array, out: Array) -> bool:
    """Solve ``shift = n . (dx, dy) + dr`` by Tukey's biweight; False where too few rays agree on it."""
    count = shift.shape[0]
    x, cov = np.zeros(3), np.zeros(3)
    scale, variance, used = 1e9, 0.0, 0.0
    for step in range(3):
        a00, a01, a02, a11, a12, a22, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        used = 0.0
        inverse_cut = 1.0 / (4.685 * scale) ** 2
        for k in range(count):
            w = weight[k]
            if w <= 0.0:
                continue
            nx, ny = direction[k, 0], direction[k, 1]
            r = shift[k] - nx * x[0] - ny * x[1] - x[2]
            u = 1.0 - r * r * w * inverse_cut
            if u <= 0.0:
                continue
            w *= u * u
            used += u
            a00 += w * nx * nx
            a01 += w * nx * ny
            a02 += w * nx
            a11 += w * ny * ny
            a12 += w * ny
            a22 += w
            b0 += w * nx * shift[k]
            b1 += w * ny * shift[k]
            b2 += w * shift[k]
        if used < LEAST_AGREEING:
            return False
        det = a00 * (a11 * a22 - a12 * a12) - a01 * (a01 * a22 - a12 * a02) + a02 * (a01 * a12 - a11 * a02)
        if det < 1e-5 * a22 * a22 * a22:
            return False
        i00, i01, i02 = (a11 * a22 - a12 * a12) / det, (a02 * a12 - a01 * a22) / det, (a01 * a12 - a02 * a11) / det
        i11, i12, i22 = (a00 * a22 - a02 * a02) / det, (a01 * a02 - a00 * a12) / det, (a00 * a11 - a01 * a01) / det
        x[0], x[1], x[2] = (
            i00 * b0 + i01 * b1 + i02 * b2,
            i01 * b0 + i11 * b1 + i12 * b2,
            i02 * b0 + i12 * b1 + i22 * b2,
        )
        cov[0], cov[1], cov[2] = i00, i01, i11
        if step == 2:
            break
        c = 0
        for k in range(count):
            if weight[k] > 0.0:
                r = shift[k] - direction[k, 0] * x[0] - direction[k, 1] * x[1] - x[2]
                work[c] = r * r * weight[k]
                c += 1
        scale = 1.4826 * math.sqrt(median_in_place(work, c)) + 0.02
        variance = max(scale, LEAST_RAY_SIGMA) ** 2
    out[0], out[1], out[9] = x[0], x[1], used / count
    out[10] = x[2]
    for p in range(3):
        out[2 + p] = cov[p] * variance * SHARED * SHARED
    return True


@compiled
def _factor(A: Array) -> None:
    """Cholesky's factors in place of the lower halves of (SIZE, SIZE, LANES); NaN where one is not positive."""
    for p in range(SIZE):
        for q in range(p + 1):
            for r in range(q):
                for lane in range(LANES):
                    A[p, q, lane] -= A[p, r, lane] * A[q, r, lane]
            if q < p:
                for lane in range(LANES):
                    A[p, q, lane] *= A[q, q, lane]
            else:
                for lane in range(LANES):
                    A[p, p, lane] = 1.0 / math.sqrt(A[p, p, lane])  # inverse: divisions are slow


@compiled
def _forward(L: Array, rhs: Array, x: Array) -> None:
    """Solve ``L x = rhs``; diagonals of L hold their inverses."""
    for p in range(SIZE):
        for lane in range(LANES):
            x[p, lane] = rhs[p, lane]
        for q in range(p):
            for lane in range(LANES):
                x[p, lane] -= L[p, q, lane] * x[q, lane]
        for lane in range(LANES):
            x[p, lane] *= L[p, p, lane]


@compiled
def _substitute(L: Array, rhs: Array, x: Array) -> None:
    """Solve ``L L^T x = rhs``."""
    _forward(L, rhs, x)
    for p in range(SIZE - 1, -1, -1):
        for q in range(p + 1, SIZE):
            for lane in range(LANES):
                x[p, lane] -= L[q, p, lane] * x[q, lane]
        for lane in range(LANES):
            x[p, lane] *= L[p, p, lane]
