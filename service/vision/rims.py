"""Measure tube ends along the normals of their projected rims.

A tube end is a circle in the sheet. Its picture under a known pose is sampled along the normals of the *projected
circle*, so there is no ellipse-centre bias; what is left to find is how far the true rim lies from the predicted one:
a shift ``(dx, dy)`` of the tube and, as a nuisance, a change ``dr`` of the apparent radius (weld ring, blur).

All grey values along a tube's rays are explained at once, by four shapes: a level, the picture's own mean edge profile
`T`, what begins beyond the tube's wall `C`, and ``-T'``, which is a shift. Each shape's share changes around the rim as
``a + b cos + c sin``: light falls unevenly on bore, tube end and plate, each in its own way, and what is not allowed to
is taken for a shift. The shift's own three are dr, dx and dy. How far the shares stray, around the rim and from ray to
ray, is known beforehand, which makes the solution a linear one with a covariance; rays that do not fit are then
weighed down (hose, glint, speck) and it is solved once more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import clipped_mean, compiled, median_in_place
from service.vision.edges import GRID, SAMPLES, profile_of
from service.vision.light import SLOPE_REACH, light_slopes
from service.vision.rays import BASIS, BORE, ENERGY, NOISE, NUMBERS, OUTSIDE, circle_of, rays_for, sample_rays

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.edges import EdgeProfile
    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Rims", "measure_rims"]

STRAY = np.array([0.05, 0.12, 0.25, 0.15, 0.04])
"""How far each shape strays from ray to ray: level, edge, what lies beyond the wall, as parts of the edge's height, and
shift, px."""
LEAN = np.array([0.1, 0.12, 0.3, 0.15])
"""How far each of the first three leans to one side of the rim: one sigma of the cosine's and of the sine's part."""
HEIGHT = 0.3
"""How far a tube's edge differs from the height that its rays told one by one, as a part of it."""
BEYOND, SEAM = 1.0, 0.5
"""One sigma of how much brighter or darker it is beyond the wall."""
RADIUS_SIGMA = 9.0
"""How far, in edge widths, one tube's apparent radius strays from the picture's: as it likes."""
OUTER_DOUBT = 0.7
"""By how many times the noise samples are in doubt, per edge width beyond one: welds and neighbours begin there."""
BEYOND_BLUR, SEAM_IN, SEAM_WIDTH = 1.0, 0.2, 0.7
"""Blur of what begins beyond the wall; how far inside the wall's edge its seam lies, and how wide: in edge widths."""
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
    functionals, normal_matrix = _shapes(
        profile.template,
        profile.width_px,
        profile.position_px,
        wall_px,
        OUTER_DOUBT,
        np.array([BEYOND_BLUR, SEAM_IN, SEAM_WIDTH]),
    )
    numbers, direction = np.empty((n, count, NUMBERS), np.float32), np.empty((n, count, 2), np.float32)
    valid, mean = np.empty((n, count), np.bool_), np.empty((n, SAMPLES))
    center, level, out = np.empty((n, 2)), np.zeros(n), np.zeros((n, 11))
    sample_rays(
        image, vector, rotation, translation_mm, sheet_mm, lattice.rim_radius_mm, circle_of(count), profile.offsets_px,
        functionals, numbers, direction, center, valid, mean, level,
    )  # fmt: skip
    noise = _levels_of(numbers, valid, normal_matrix, out)
    if profile.learnt:
        _solve(numbers, direction, valid, normal_matrix, noise * NOISE_SCALE, STRAY**2, _prior(profile), out)
    else:
        _find(numbers, direction, valid, normal_matrix, REACH * profile.width_px, out)
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


def _prior(profile: EdgeProfile) -> Array:
    """Information, (BASIS, 3), that draws each shape's mean, cosine's and sine's part to what is expected."""
    prior = np.zeros((BASIS, 3))
    prior[:-1, 1:] = LEAN[:, None] ** -2.0
    prior[1:, 0] = HEIGHT**-2.0, BEYOND**-2.0, SEAM**-2.0, (RADIUS_SIGMA * profile.width_px) ** -2.0
    return prior


def _px_per_mm(vector: Array, rotation: Array, translation_mm: Array, sheet_mm: Array) -> float:
    """Scale in the middle of the places, px per mm."""
    middle = sheet_mm.mean(axis=0)
    depth = rotation[2, 0] * middle[0] + rotation[2, 1] * middle[1] + translation_mm[2]
    return math.sqrt(vector[0] * vector[1]) / max(float(depth), 1e-6)


@compiled
def _shapes(
    T: Array, width: float, position: float, wall_px: float, outer_doubt: float, look: Array
) -> tuple[NDArray[np.float32], Array]:
    """What samples are multiplied with, (BASIS + 1, SAMPLES), and the shapes' normal matrix, (BASIS, BASIS).

    For noise of one grey value over one px; the last row weighs squares of samples.
    """
    functionals, M = np.empty((BASIS + 1, SAMPLES), np.float32), np.zeros((BASIS, BASIS))
    row, last = np.empty(BASIS), SAMPLES - 1
    for j in range(SAMPLES):
        left, right = max(j - 1, 0), min(j + 1, last)
        span = GRID[right] - GRID[left]
        slope = (T[right] - T[left]) / (width * span)
        u = (position - wall_px) / width + GRID[j]
        beyond = 0.5 * (1.0 + math.erf(u / (look[0] * math.sqrt(2.0))))
        seam = math.exp(-0.5 * ((u + look[1]) / look[2]) ** 2)
        row[0], row[1], row[2], row[3], row[4] = 1.0, T[j], beyond, seam, -slope
        doubt = outer_doubt * max(GRID[j] - 1.0, 0.0)
        weight = width * span / (right - left) / (1.0 + doubt * doubt)
        functionals[BASIS, j] = weight
        for p in range(BASIS):
            functionals[p, j] = weight * row[p]
            for q in range(BASIS):
                M[p, q] += weight * row[p] * row[q]
    return functionals, M


@compiled
def _levels_of(numbers: NDArray[np.float32], valid: NDArray[np.bool_], M: Array, out: Array) -> float:
    """Levels, height of the edge and strength of each tube, into `out`; gives the noise of a grey value.

    The columns of `out` are those of `Rims`: shift x, y; covariance xx, xy, yy; gain, bore, outside, strength, rays,
    radius; lengths in px of x.
    """
    count = numbers.shape[1]
    work, noises, told = np.empty(count), np.empty(numbers.shape[0]), 0
    edge = M[1, 1] * M[4, 4] - M[1, 4] * M[1, 4]
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
                b, d = numbers[i, k, 1] - bore * M[0, 1], numbers[i, k, 4] - bore * M[0, 4]
                work[n] = (b * M[4, 4] - d * M[1, 4]) / edge
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
def _solve(
    numbers: NDArray[np.float32], direction: NDArray[np.float32], valid: NDArray[np.bool_], M0: Array, noise: float,
    stray: Array, prior: Array, out: Array,
) -> None:  # fmt: skip
    """Shift, radius and covariance of each tube, into `out`, which holds the levels already.

    A ray's samples have the covariance ``R = s^2 W^-1 + B S B^T``: noise, and the shapes `B` straying by `S`. With
    ``K = (I + M0 S / s^2)^-1 / s^2`` that gives ``B^T R^-1 = K B^T W``, so that sums of a ray's numbers are all it
    takes.
    """
    count = numbers.shape[1]
    weight, misfit, work = np.empty(count), np.empty(count), np.empty(count)
    z, d, share = np.empty((count, BASIS)), np.empty(BASIS), np.empty(BASIS)
    H, Z, rhs, x = np.empty((3, 3)), np.empty((BASIS, 3)), np.empty(SIZE), np.empty(SIZE)
    A = np.empty((SIZE, SIZE))
    for i in range(numbers.shape[0]):
        o = out[i]
        gain, bore = o[5], o[6]
        if not gain > 0.0 or o[9] == 0.0:
            continue
        precision = 1.0 / ((noise / gain) ** 2 + MODEL * MODEL)
        K = np.linalg.inv(np.eye(BASIS) + precision * M0 * stray) * precision
        M = K @ M0
        for k in range(count):
            weight[k] = 1.0 if valid[i, k] else 0.0
            for p in range(BASIS):
                z[k, p] = (numbers[i, k, p] - bore * M0[0, p]) / gain
        usual, agreeing = 1.0, 0.0
        for step in range(ROUNDS):
            H[:], Z[:], agreeing = 0.0, 0.0, 0.0
            for k in range(count):
                w = weight[k]
                if w <= 0.0:
                    continue
                agreeing += w
                ux, uy = direction[i, k, 0], direction[i, k, 1]
                H[0, 0] += w
                H[0, 1] += w * ux
                H[0, 2] += w * uy
                H[1, 1] += w * ux * ux
                H[1, 2] += w * ux * uy
                H[2, 2] += w * uy * uy
                for p in range(BASIS):
                    y = w * z[k, p]
                    Z[p, 0] += y
                    Z[p, 1] += y * ux
                    Z[p, 2] += y * uy
            if agreeing < LEAST_AGREEING:
                break
            H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
            for p in range(BASIS):
                for h in range(3):
                    y = 0.0
                    for q in range(BASIS):
                        y += K[p, q] * Z[q, h]
                    rhs[3 * p + h] = y
                    for q in range(p + 1):
                        for g in range(3):
                            A[3 * p + h, 3 * q + g] = M[p, q] * H[h, g]
                    A[3 * p + h, 3 * p + h] += prior[p, h]
            rhs[3] += prior[1, 0]
            if not _factor(A):
                agreeing = 0.0
                break
            _substitute(A, rhs, x)
            if step == ROUNDS - 1:
                break
            n = 0
            for k in range(count):
                if not valid[i, k]:
                    continue
                ux, uy = direction[i, k, 0], direction[i, k, 1]
                raw = numbers[i, k, ENERGY] - bore * (2.0 * numbers[i, k, 0] - bore * M0[0, 0])
                square = raw / (gain * gain)
                for p in range(BASIS):
                    share[p] = x[3 * p] + ux * x[3 * p + 1] + uy * x[3 * p + 2]
                for p in range(BASIS):
                    d[p] = z[k, p]
                    for q in range(BASIS):
                        d[p] -= M0[p, q] * share[q]
                    square -= share[p] * (z[k, p] + d[p])
                square *= precision
                for p in range(BASIS):  # what straying shapes explain of the residual
                    y = 0.0
                    for q in range(BASIS):
                        y += K[p, q] * d[q]
                    square -= precision * stray[p] * d[p] * y
                misfit[k] = square / SAMPLES
                work[n] = misfit[k]
                n += 1
            usual = max(median_in_place(work, n), 1e-3)
            for k in range(count):
                if valid[i, k]:
                    weight[k] = max(1.0 - misfit[k] / (CUT * usual), 0.0)
        o[9] = agreeing / count
        if agreeing < LEAST_AGREEING:
            o[8] = -1.0
            continue
        height, radius = max(x[3], LEAST_GAIN), x[SIZE - 3]
        o[10] = radius / height
        o[0] = (x[SIZE - 2] - x[4] * o[10]) / height
        o[1] = (x[SIZE - 1] - x[5] * o[10]) / height
        # the last two rows of the factor are all that the inverse's last corner takes
        a, b, c = A[SIZE - 2, SIZE - 2], A[SIZE - 1, SIZE - 2], A[SIZE - 1, SIZE - 1]
        excess = max(usual, LEAST_MISFIT) * SPREAD * SPREAD
        o[2] = (1.0 / (a * a) + (b / (a * c)) ** 2) * excess
        o[3] = -b / (a * c * c) * excess
        o[4] = 1.0 / (c * c) * excess


@compiled
def _find(
    numbers: NDArray[np.float32], direction: NDArray[np.float32], valid: NDArray[np.bool_], M: Array, reach: float,
    out: Array,
) -> None:  # fmt: skip
    """Shift, radius and covariance of each tube whose edge may lie far off, ray by ray, into `out`."""
    count = numbers.shape[1]
    edge = M[1, 1] * M[4, 4] - M[1, 4] * M[1, 4]
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
            b, d = numbers[i, k, 1] - bore * M[0, 1], numbers[i, k, 4] - bore * M[0, 4]
            g, moved = (b * M[4, 4] - d * M[1, 4]) / edge, (d * M[1, 1] - b * M[1, 4]) / edge
            if g > LEAST_RAY_GAIN * gain and abs(moved) < reach * g:
                shift[k] = moved / g
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
def _factor(A: Array) -> bool:
    """Cholesky's factor in place of the lower half; False where the matrix is not positive."""
    for p in range(A.shape[0]):
        for q in range(p + 1):
            y = A[p, q]
            for r in range(q):
                y -= A[p, r] * A[q, r]
            if q < p:
                A[p, q] = y / A[q, q]
            elif y <= 0.0:
                return False
            else:
                A[p, p] = math.sqrt(y)
    return True


@compiled
def _substitute(L: Array, rhs: Array, x: Array) -> None:
    """Solve ``L L^T x = rhs``."""
    n = L.shape[0]
    for p in range(n):
        y = rhs[p]
        for q in range(p):
            y -= L[p, q] * x[q]
        x[p] = y / L[p, p]
    for p in range(n - 1, -1, -1):
        y = x[p]
        for q in range(p + 1, n):
            y -= L[q, p] * x[q]
        x[p] = y / L[p, p]
