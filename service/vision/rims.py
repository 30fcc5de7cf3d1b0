"""Measure tube ends along the normals of their projected rims.

A tube end is a circle in the sheet. Its picture under a known pose is sampled along the normals of the *projected
circle*, so there is no ellipse-centre bias; what is left to find is how far the true rim lies from the predicted one:
a shift ``(dx, dy)`` of the tube and, as a nuisance, a change ``dr`` of the apparent radius (weld ring, blur).

Each ray's grey values are explained as ``offset + gain * T(u - s)``: `T` is the picture's own mean edge profile, `s`
the ray's shift. Where the tube wall is narrower than the blur the gain is drawn towards the tube's mean: a glint on the
weld bead beyond the wall would otherwise pull the edge outwards on the lit side and shift all tubes together
(`solve_feet` measures what remains of that). Then ``s_i = n_i . (dx, dy) + dr`` is solved over the rays by Tukey's
biweight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import clipped_mean, compiled, median_in_place
from service.vision.projection import project_point

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = [
    "EdgeProfile",
    "RimSamples",
    "Rims",
    "light_shift",
    "mean_profiles",
    "profile_of",
    "sample_rims",
    "solve_feet",
    "solve_rims",
    "start_profile",
]

NODES = 8
"""Points of a circle that are projected exactly; a trigonometric polynomial through them gives the others."""
SAMPLES = 16
GRID = -3.8 + 0.45 * np.arange(SAMPLES)
"""Where a ray is sampled, in edge widths from the edge's place."""
INSIDE = np.where(np.arange(SAMPLES) < 3, 1 / 3, 0.0)
OUTSIDE = np.where(np.arange(SAMPLES) >= SAMPLES - 2, 1 / 2, 0.0)
"""What makes the mean level of a ray's inner end, which lies in the bore, and of its outer end."""
EDGE = np.exp(-0.5 * ((GRID + 0.07) / 0.44) ** 2)
"""What a sample counts for: just inside of half height, where glints beyond the edge hardly reach. Least noise."""
FOOT = np.where(GRID < 0.25, 1.0, 0.0)
"""The same for all of the edge's foot, with each ray's offset its own. Least bias."""
OFFSET_PRIOR = 0.27
"""How strongly a ray's offset is drawn to the tube's, relative to the ray's own information; the foot's is free."""
SLOPE_REACH = 2.3
"""How far, in pitches, neighbours tell how the light falls off."""
SLOPE_STRENGTH = 4.0
SLOPE_PRIOR = 0.3
"""Information, in tubes at the edge of that reach, that draws the light towards level."""
SLOPE_STRAY = 0.8
"""A tube whose edge differs by this, as a logarithm, is stained and does not tell."""
LIGHT_SHIFT, LIGHT_BLUR, SHARP_PX = 0.3, 2.0, 0.8
"""What uneven light shifts a rim by, in `Rims.light_px`: on sharp pictures, and more per px of blur beyond SHARP_PX."""
LEAST_GAIN = 0.12
"""A ray whose gain falls below this share of the tube's shows no edge."""
REACH = 1.6
"""Largest shift of a ray, in edge widths, that the linear model serves."""
RADIUS_SIGMA, FOOT_RADIUS_SIGMA = 9.0, 0.06
"""How far, in edge widths, one tube's apparent radius strays from the picture's: as it likes for whole edges, by next
to nothing for their feet."""


LEAST_RAYS = 8
"""Fewer rays in the picture tell nothing of a tube."""
LEAST_AGREEING = 6.0
LEAST_RAY_SIGMA = 0.05
"""A ray is never better than this, px: the template is not exact."""
SHARED = 1.4
"""Neighbouring rays see the same pixels: their common error counts once, measured on truth."""
WIDTH_LIMITS_PX = (0.5, 4.5)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeProfile:
    """How the edge of a rim looks in a picture.

    Attributes
    ----------
    position_px
        Where its half height lies, outwards of the nominal rim.
    width_px
        One sigma of the blur that its foot shows.
    template
        (SAMPLES,) mean profile at ``position_px + width_px * GRID``: 0 in the bore, 1 on the tube end.
    """

    position_px: float
    width_px: float
    template: NDArray[np.float64]

    @property
    def offsets_px(self) -> NDArray[np.float64]:
        """Where rays are sampled, (SAMPLES,) px outwards of the nominal rim."""
        return np.asarray(self.position_px + self.width_px * GRID)


def start_profile(width_px: float = 1.2, position_px: float = 0.0) -> EdgeProfile:
    """A blurred step, to begin with."""
    return EdgeProfile(position_px, width_px, np.array([0.5 * (1 + math.erf(x / math.sqrt(2))) for x in GRID]))


@dataclass(frozen=True, slots=True, eq=False)
class RimSamples:
    """Grey values along the rays of n predicted rims.

    Attributes
    ----------
    grey
        (n, rays, SAMPLES) float32.
    normal
        (n, rays, 2) gradient of the distance across the rim by a shift in x and y: outward normals, of unit length
        where pixels are square. Distances along a ray are in px of x.
    valid
        (n, rays) whether the ray lies in the picture.
    center_px
        (n, 2) where the centre of each tube-end circle projects; NaN where it does not.
    radius_px, pitch_px
        Rim radius and lattice pitch in the middle of the picture, px of x.
    aspect
        Height of a pixel over its width.
    resolved
        Width of the tube wall over that of the edge's blur.
    profile
        The edge that placed the samples.
    """

    grey: NDArray[np.float32]
    normal: NDArray[np.float64]
    valid: NDArray[np.bool_]
    center_px: NDArray[np.float64]
    radius_px: float
    pitch_px: float
    aspect: float
    resolved: float
    profile: EdgeProfile


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """What the rims showed, in the order asked for.

    Attributes
    ----------
    shift_px
        (n, 2) measured minus predicted centre.
    radius_px
        (n,) change of the apparent radius against the profile's.
    covariance_px
        (n, 3) xx, xy, yy of the shift.
    gain, bore, outside
        (n,) grey: height of the edge, level in the bore, level at the rays' outer ends.
    strength
        (n,) height of the edge over its uncertainty, as the rays tell it; negative where nothing could be measured.
    rays
        (n,) share of the rays that take part.
    light_px
        (n, 2) edge width times the relative change of the light from the tube's centre to its rim: what uneven light
        may shift a rim by.
    """

    shift_px: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    covariance_px: NDArray[np.float64]
    gain: NDArray[np.float64]
    bore: NDArray[np.float64]
    outside: NDArray[np.float64]
    strength: NDArray[np.float64]
    rays: NDArray[np.float64]
    light_px: NDArray[np.float64]


def sample_rims(
    image: Image,
    vector: Array,
    rotation: Array,
    translation_mm: Array,
    sheet_mm: Array,
    lattice: Lattice,
    profile: EdgeProfile,
    rays: int | None = None,
) -> RimSamples:
    """Sample the rims of the tubes at `sheet_mm`, (n, 2) nominal places, n >= 1.

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
    scale = _px_per_mm(vector, rotation, translation_mm, sheet_mm)
    count = rays or int(np.clip(round(2 * math.pi * lattice.rim_radius_mm * scale / 2.2 / 4) * 4, 16, 48))
    turn, slope = _circle(count)
    n = len(sheet_mm)
    grey, normal = np.empty((n, count, SAMPLES), np.float32), np.empty((n, count, 2))
    center, valid = np.empty((n, 2)), np.empty((n, count), np.bool_)
    _sample(
        image, vector, rotation, translation_mm, sheet_mm, lattice.rim_radius_mm, turn, slope, profile.offsets_px,
        grey, normal, center, valid,
    )  # fmt: skip
    wall = (lattice.outer_radius_mm - lattice.rim_radius_mm) * scale
    return RimSamples(
        grey, normal, valid, center, lattice.rim_radius_mm * scale, lattice.pitch_mm * scale,
        float(vector[0] / vector[1]),
        max(wall / profile.width_px, 1e-3), profile,
    )  # fmt: skip


def solve_rims(samples: RimSamples) -> Rims:
    """Solve for every tube's shift with the least noise: foot and middle of the edge."""
    everyone = np.arange(len(samples.grey))
    gain_prior = float(np.clip((2.05 / samples.resolved) ** 5.2, 0.003, 30.0))
    return _solved(samples, everyone, EDGE, OFFSET_PRIOR, gain_prior, RADIUS_SIGMA)


def solve_feet(samples: RimSamples, which: NDArray[np.int64]) -> Rims:
    """Solve for the shift of the tubes `which` with the least bias: the foot of the edge alone.

    Nothing beyond the edge reaches it, neither a glint on the weld bead nor light that falls off across the tube: each
    ray's offset and gain are its own. It is noisier, and serves to tell what all the others have in common.
    """
    gain_prior = float(np.clip((1.45 / samples.resolved) ** 4.1, 0.0, 30.0))
    return _solved(samples, which, FOOT, 0.0, gain_prior, FOOT_RADIUS_SIGMA)


def _solved(
    samples: RimSamples, which: NDArray[np.int64], window: Array, offset_prior: float, gain_prior: float, radius: float
) -> Rims:
    profile, out = samples.profile, np.empty((len(which), 11))
    basis = np.column_stack(
        [np.ones(SAMPLES), profile.template, -np.gradient(profile.template, profile.width_px * GRID)]
    )
    M = (basis.T * window) @ basis
    Q = np.linalg.inv(M + np.diag([offset_prior * M[0, 0], gain_prior * M[1, 1], 0.0]))
    functionals = np.column_stack([basis * window[:, None], INSIDE, OUTSIDE]).astype(np.float32)
    dots = samples.grey @ functionals
    width = profile.width_px
    slope = np.zeros((len(which), 2))
    _levels_of(dots, samples.valid, which, M, out)
    _light_slopes(samples.center_px[which], samples.aspect, out, SLOPE_REACH * samples.pitch_px, slope)
    slope *= samples.radius_px
    _solve(
        dots, samples.normal, samples.valid, which, M, Q, gain_prior, slope, samples.aspect, radius * width,
        REACH * width, out,
    )  # fmt: skip
    light = slope * [width, width / samples.aspect]
    return Rims(
        shift_px=out[:, 0:2] + light_shift(width) * light, covariance_px=out[:, 2:5], gain=out[:, 5], bore=out[:, 6],
        outside=out[:, 7], strength=out[:, 8], rays=out[:, 9], radius_px=out[:, 10], light_px=light,
    )  # fmt: skip


def light_shift(width_px: float) -> float:
    """By how many `Rims.light_px` uneven light moves a rim away from the light.

    Brighter edges look further in, even after the gains are accounted for; the more so where they are blurred. Measured
    on truth.
    """
    return LIGHT_SHIFT + LIGHT_BLUR * max(0.0, width_px - SHARP_PX)


def _px_per_mm(vector: Array, rotation: Array, translation_mm: Array, sheet_mm: Array) -> float:
    """Scale in the middle of the places, px per mm."""
    middle = sheet_mm.mean(axis=0)
    depth = rotation[2, 0] * middle[0] + rotation[2, 1] * middle[1] + translation_mm[2]
    return math.sqrt(vector[0] * vector[1]) / max(float(depth), 1e-6)


@lru_cache(maxsize=64)
def _circle(count: int) -> tuple[Array, Array]:
    """Matrices (count, NODES) that take a circle's NODES projected points to `count` points and their derivatives."""
    d = 2 * np.pi * (np.arange(count)[:, None] / count - np.arange(NODES)[None] / NODES)
    value, slope = np.ones_like(d), np.zeros_like(d)
    for harmonic in range(1, NODES // 2):
        value += 2 * np.cos(harmonic * d)
        slope -= 2 * harmonic * np.sin(harmonic * d)
    value += np.cos(NODES // 2 * d)
    slope -= NODES // 2 * np.sin(NODES // 2 * d)
    return value / NODES, slope / NODES


@compiled
def _sample(
    image: Image, v: Array, R: Array, t: Array, sheet_mm: Array, radius_mm: float, turn: Array, slope: Array,
    offsets: Array, grey: NDArray[np.float32], normal: Array, center: Array, valid: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Grey values along the normals of projected circles, bilinear; a ray that leaves the picture is not valid."""
    h, w = image.shape
    count, last = turn.shape[0], offsets.shape[0] - 1
    aspect = v[0] / v[1]
    nodes, scratch, place = np.empty((NODES, 2)), np.empty((6, SAMPLES), np.float32), np.empty(SAMPLES, np.int32)
    for i in range(sheet_mm.shape[0]):
        center[i, 0], center[i, 1] = project_point(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], 0.0)
        sign = _project_circle(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], radius_mm, nodes)
        if math.isnan(center[i, 0]) or sign == 0.0:
            valid[i] = False
            grey[i] = 0.0
            continue
        for k in range(count):
            x, y, tx, ty = 0.0, 0.0, 0.0, 0.0
            for j in range(NODES):
                x += turn[k, j] * nodes[j, 0]
                y += turn[k, j] * nodes[j, 1]
                tx += slope[k, j] * nodes[j, 0]
                ty += slope[k, j] * nodes[j, 1]
            ty *= aspect  # square up the pixels: blur and edge are round on the sensor, not in a field's lines
            length = math.sqrt(tx * tx + ty * ty)
            nx, ny = sign * ty / length, -sign * tx / length
            normal[i, k, 0], normal[i, k, 1] = nx, aspect * ny
            ny /= aspect
            x0, x1 = x + offsets[0] * nx, x + offsets[last] * nx
            y0, y1 = y + offsets[0] * ny, y + offsets[last] * ny
            inside = min(x0, x1) >= 0.0 and max(x0, x1) < w - 1.01 and min(y0, y1) >= 0.0 and max(y0, y1) < h - 1.01
            valid[i, k] = inside
            if inside:
                _along(image, x, y, nx, ny, offsets, place, scratch, grey[i, k])
            else:
                grey[i, k] = 0.0


@compiled
def _project_circle(v: Array, R: Array, t: Array, x: float, y: float, radius_mm: float, nodes: Array) -> float:
    """Project NODES points of a circle; gives the sense they run in, +1 or -1, or 0 where a point has no image."""
    for j in range(NODES):
        a = 2.0 * math.pi * j / NODES
        px, py = project_point(v, R, t, x + radius_mm * math.cos(a), y + radius_mm * math.sin(a), 0.0)
        if math.isnan(px):
            return 0.0
        nodes[j, 0], nodes[j, 1] = px, py
    area = 0.0
    for j in range(NODES):
        k = (j + 1) % NODES
        area += nodes[j, 0] * nodes[k, 1] - nodes[k, 0] * nodes[j, 1]
    return 1.0 if area > 0.0 else -1.0


@compiled
def _along(
    image: Image, x: float, y: float, nx: float, ny: float, offsets: Array, place: NDArray[np.int32],
    scratch: NDArray[np.float32], grey: NDArray[np.float32],
) -> None:  # fmt: skip
    """Bilinear grey values at (x, y) + offsets * n; in three loops, of which two run eight at a time."""
    width = np.int32(image.shape[1])
    flat = image.reshape(-1)
    x0, y0, dx, dy = np.float32(x), np.float32(y), np.float32(nx), np.float32(ny)
    fx, fy, p, q, r, s = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5]
    for j in range(SAMPLES):
        u = np.float32(offsets[j])
        xs, ys = x0 + u * dx, y0 + u * dy
        ix, iy = np.int32(xs), np.int32(ys)
        fx[j], fy[j] = xs - np.float32(ix), ys - np.float32(iy)
        place[j] = iy * width + ix
    for j in range(SAMPLES):
        k = np.uint32(place[j])
        below = k + np.uint32(width)
        p[j], q[j], r[j], s[j] = flat[k], flat[k + np.uint32(1)], flat[below], flat[below + np.uint32(1)]
    for j in range(SAMPLES):
        top = p[j] + fx[j] * (q[j] - p[j])
        grey[j] = top + fy[j] * (r[j] + fx[j] * (s[j] - r[j]) - top)


@compiled
def _levels_of(
    dots: NDArray[np.float32], valid: NDArray[np.bool_], which: NDArray[np.int64], M: Array, out: Array
) -> None:
    """Levels, height of the edge and strength of each tube, into `out`, which is laid out as `Rims`."""
    count = dots.shape[1]
    work = np.empty(count)
    for row in range(which.shape[0]):
        i, o = which[row], out[row]
        o[:] = 0.0
        o[8] = -1.0
        seen = 0
        for k in range(count):
            seen += valid[i, k]
        if seen < LEAST_RAYS:
            continue
        o[6], o[7], o[5], spread = _levels(dots[i], valid[i], M, work)
        o[8] = o[5] * math.sqrt(seen) / (spread + 1e-6)
        o[9] = seen / count


@compiled
def _light_slopes(center: Array, aspect: float, out: Array, reach: float, slope: Array) -> None:
    """How the light falls off at each tube, (n, 2) per px: slope of the logarithm of its neighbours' edges' height.

    A plane through the neighbours, drawn towards level light; one reweighting sets stained tubes aside.
    """
    n = center.shape[0]
    for row in range(n):
        if out[row, 8] < SLOPE_STRENGTH:
            continue
        x0, y0 = center[row, 0], center[row, 1] * aspect
        a, bx, by = math.log(out[row, 5]), 0.0, 0.0
        for step in range(3):
            s0, sx, sy, sxx, sxy, syy, t0, tx, ty = 0.0, 0.0, 0.0, SLOPE_PRIOR, 0.0, SLOPE_PRIOR, 0.0, 0.0, 0.0
            for other in range(n):
                if out[other, 8] < SLOPE_STRENGTH:
                    continue
                dx, dy = (center[other, 0] - x0) / reach, (center[other, 1] * aspect - y0) / reach
                d2 = dx * dx + dy * dy
                if d2 >= 1.0:
                    continue
                z = math.log(out[other, 5])
                w = (1.0 - d2) ** 2
                if step > 0:
                    r = (z - a - bx * dx - by * dy) / SLOPE_STRAY
                    if r * r >= 1.0:
                        continue
                    w *= (1.0 - r * r) ** 2
                s0 += w
                sx += w * dx
                sy += w * dy
                sxx += w * dx * dx
                sxy += w * dx * dy
                syy += w * dy * dy
                t0 += w * z
                tx += w * z * dx
                ty += w * z * dy
            if s0 < 2.0:
                bx, by = 0.0, 0.0
                break
            cxx, cxy, cyy = sxx - sx * sx / s0, sxy - sx * sy / s0, syy - sy * sy / s0
            ux, uy = tx - sx * t0 / s0, ty - sy * t0 / s0
            det = cxx * cyy - cxy * cxy
            bx, by = (cyy * ux - cxy * uy) / det, (cxx * uy - cxy * ux) / det
            a = (t0 - bx * sx - by * sy) / s0
        slope[row, 0], slope[row, 1] = bx / reach, by / reach


@compiled
def _solve(
    dots: NDArray[np.float32], normal: Array, valid: NDArray[np.bool_], which: NDArray[np.int64], M: Array, Q: Array,
    gain_prior: float, slope: Array, aspect: float, radius_sigma: float, reach: float, out: Array,
) -> None:  # fmt: skip
    """Shift, radius and covariance of each tube from its rays, into `out`, which holds the levels already.

    Parameters
    ----------
    dots
        (n, rays, 5) of each ray's grey values with 1, T, -T' under the window, and its mean level inside and outside.
    M, Q
        (3, 3) normal matrix of the basis (1, T, -T') under the window, and its inverse with the priors added: a ray's
        offset, gain, and gain times shift.
    slope
        (len(which), 2) relative change of the light from a tube's centre to its rim, along x and y.
    """
    count = dots.shape[1]
    work, shift, weight = np.empty(count), np.empty(count), np.empty(count)
    for row in range(which.shape[0]):
        i, o = which[row], out[row]
        if o[5] <= 0.0 or o[9] == 0.0:
            continue
        _ray_shifts(
            dots[i], normal[i], valid[i], M, Q, o[6], o[5], gain_prior, slope[row], aspect, reach, shift, weight
        )
        if not _circle_fit(normal[i], shift, weight, radius_sigma, work, o):
            o[8] = -1.0


@compiled
def _levels(
    dots: NDArray[np.float32], valid: NDArray[np.bool_], M: Array, work: Array
) -> tuple[float, float, float, float]:
    """One tube's level in the bore, at the rays' outer ends, height of its edge, and the rays' spread about that."""
    bore, outside, gain, spread = 0.0, 0.0, 0.0, 0.0
    edge = M[1, 1] * M[2, 2] - M[1, 2] * M[1, 2]
    for what in range(3):
        n = 0
        for k in range(dots.shape[0]):
            if valid[k]:
                if what == 0:
                    work[n] = dots[k, 3]
                elif what == 1:
                    work[n] = dots[k, 4]
                else:
                    b, c = dots[k, 1] - bore * M[0, 1], dots[k, 2] - bore * M[0, 2]
                    work[n] = (b * M[2, 2] - c * M[1, 2]) / edge
                n += 1
        level, stray = clipped_mean(work, n)
        if what == 0:
            bore = level
        elif what == 1:
            outside = level
        else:
            gain, spread = level, 1.25 * stray
    return bore, outside, gain, spread


@compiled
def _ray_shifts(
    dots: NDArray[np.float32], normal: Array, valid: NDArray[np.bool_], M: Array, Q: Array, bore: float, gain: float,
    gain_prior: float, slope: Array, aspect: float, reach: float, shift: Array, weight: Array,
) -> None:  # fmt: skip
    """Each ray's shift (px) and its weight, 0 where it shows no edge; brighter rays count more, up to a limit."""
    for k in range(dots.shape[0]):
        weight[k] = 0.0
        if not valid[k]:
            continue
        expected = gain * max(1.0 + slope[0] * normal[k, 0] + slope[1] * normal[k, 1] / aspect, 0.3)
        a = dots[k, 0] - bore * M[0, 0]
        b = dots[k, 1] - bore * M[0, 1] + gain_prior * M[1, 1] * expected
        c = dots[k, 2] - bore * M[0, 2]
        g = Q[1, 0] * a + Q[1, 1] * b + Q[1, 2] * c
        gs = Q[2, 0] * a + Q[2, 1] * b + Q[2, 2] * c
        if g > LEAST_GAIN * gain and abs(gs) < reach * g:
            shift[k] = gs / g
            weight[k] = min(g / gain, 1.5) ** 2


@compiled
def _circle_fit(normal: Array, shift: Array, weight: Array, radius_sigma: float, work: Array, out: Array) -> bool:
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
            nx, ny = normal[k, 0], normal[k, 1]
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
        a22 += variance / (radius_sigma * radius_sigma)
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
                r = shift[k] - normal[k, 0] * x[0] - normal[k, 1] * x[1] - x[2]
                work[c] = r * r * weight[k]
                c += 1
        scale = 1.4826 * math.sqrt(median_in_place(work, c)) + 0.02
        variance = max(scale, LEAST_RAY_SIGMA) ** 2
    out[0], out[1], out[9] = x[0], x[1], used / count
    out[10] = x[2]
    for p in range(3):
        out[2 + p] = cov[p] * variance * SHARED * SHARED
    return True


def profile_of(samples: RimSamples, rims: Rims) -> EdgeProfile | None:
    """The mean edge of the clearest tubes, placed and scaled anew; None where too few show one."""
    clear = np.flatnonzero((rims.strength > 20) & (rims.rays > 0.6))
    if len(clear) < 4:
        clear = np.argsort(-rims.strength)[: max(4, len(rims.strength) // 5)]
        clear = clear[rims.strength[clear] > 5]
    if len(clear) < 4:
        return None
    mean = np.empty((len(clear), SAMPLES))
    mean_profiles(samples.grey, samples.valid, clear, mean)
    profile = np.median((mean - rims.bore[clear, None]) / rims.gain[clear, None], axis=0)
    profile -= profile @ INSIDE
    top = float(profile[: np.searchsorted(GRID, 1.9)].max())
    foot, half = _crossing(profile, 0.16 * top), _crossing(profile, 0.5 * top)
    if foot is None or half is None or half <= foot:
        return None
    offsets = samples.profile.offsets_px
    position = float(np.interp(half, np.arange(SAMPLES), offsets))
    width = float(np.clip(position - np.interp(foot, np.arange(SAMPLES), offsets), *WIDTH_LIMITS_PX))
    return EdgeProfile(position, width, np.interp(position + width * GRID, offsets, profile / top))


def _crossing(profile: Array, level: float) -> float | None:
    """Where the profile first rises through `level`, in samples."""
    k = int(np.argmax(profile > level))
    if k == 0:
        return None
    return k - 1 + float((level - profile[k - 1]) / (profile[k] - profile[k - 1]))


@compiled
def mean_profiles(grey: NDArray[np.float32], valid: NDArray[np.bool_], which: NDArray[np.int64], mean: Array) -> None:
    """Average the rays of the tubes `which` into `mean`, (len(which), SAMPLES)."""
    for j in range(which.shape[0]):
        i, c = which[j], 0
        mean[j] = 0.0
        for k in range(grey.shape[1]):
            if valid[i, k]:
                c += 1
                for s in range(grey.shape[2]):
                    mean[j, s] += grey[i, k, s]
        for s in range(grey.shape[2]):
            mean[j, s] /= max(c, 1)
