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
    "Rims",
    "light_shift",
    "measure_rims",
    "profile_of",
    "solve_feet",
    "start_profile",
]

NODES = 8
"""Points of a circle that are projected exactly; a trigonometric polynomial through them gives the others."""
_ANGLE = 2 * np.pi * np.arange(NODES) / NODES
NODE_WAVES = np.column_stack([np.ones(NODES), np.cos(_ANGLE), np.sin(_ANGLE), np.cos(2 * _ANGLE), np.sin(2 * _ANGLE)])
RAY_SPACING_PX, FEWEST_RAYS, MOST_RAYS = 2.8, 16, 24
"""Rays stand this far apart on the rim, as neighbours would see the same pixels; more of them gain little."""
SAMPLES = 12
GRID = np.array([-3.6, -2.9, -2.2, -1.6, -1.1, -0.65, -0.2, 0.25, 0.7, 1.3, 2.0, 2.9])
"""Where a ray is sampled, in edge widths from the edge's place."""
INNER = 3
"""Samples at a ray's inner end that lie in the bore; its two last ones lie outside."""
EDGE_FROM, EDGE_TO, FOOT_TO = 4, 9, 8
"""The samples that the two windows span."""
EDGE = np.where(
    (np.arange(SAMPLES) >= EDGE_FROM) & (np.arange(SAMPLES) < EDGE_TO), np.exp(-0.5 * ((GRID + 0.07) / 0.44) ** 2), 0
)
"""What a sample counts for: the middle of the edge. Least noise."""
FOOT = np.where(np.arange(SAMPLES) < FOOT_TO, np.gradient(GRID), 0.0)
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
TOP = int(np.searchsorted(GRID, 1.9))
"""Samples among which an edge's top is looked for: farther out the weld begins."""


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
class Rims:
    """What the rims at n predicted places showed, in the order asked for.

    Attributes
    ----------
    center_px
        (n, 2) measured centre of each tube-end circle's projection; NaN where it has none.
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
    shift_px
        (n, 2) how far the centre lies from where it was predicted.
    rays_dots, rays_normal, rays_valid, mean
        What was seen along the rays, for `solve_feet` and `profile_of`.
    look
        What the rays were sampled and weighed with.
    """

    center_px: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    covariance_px: NDArray[np.float64]
    gain: NDArray[np.float64]
    bore: NDArray[np.float64]
    outside: NDArray[np.float64]
    strength: NDArray[np.float64]
    rays: NDArray[np.float64]
    light_px: NDArray[np.float64]
    shift_px: NDArray[np.float64]
    seen: Seen


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Grey values along the rays of n predicted rims, condensed.

    Attributes
    ----------
    dots
        (n, rays, 8) float32: a ray's samples with (1, T, -T') under the window of whole edges and under that of their
        feet, and its mean level inside and outside.
    normal
        (n, rays, 2) gradient of the distance across the rim by a shift in x and y: outward normals, of unit length
        where pixels are square. Distances along a ray are in px of x.
    valid
        (n, rays) whether the ray lies in the picture.
    mean
        (n, SAMPLES) mean profile of each tube's rays.
    slope
        (n, 2) relative change of the light from the tube's centre to its rim.
    aspect
        Height of a pixel over its width.
    profile
        The edge that placed the samples.
    edge, foot
        How each window weighs them.
    """

    dots: NDArray[np.float32]
    normal: NDArray[np.float64]
    valid: NDArray[np.bool_]
    mean: NDArray[np.float64]
    slope: NDArray[np.float64]
    aspect: float
    profile: EdgeProfile
    edge: Window
    foot: Window


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """How the samples of a ray are weighed.

    Attributes
    ----------
    normal_matrix
        (3, 3) of the basis (1, T, -T') under the window.
    inverse
        (3, 3) its inverse with the priors added: gives a ray's offset, gain, and gain times shift.
    gain_prior
        Information that draws a ray's gain to the tube's, relative to the ray's own.
    radius_sigma_px
        How far one tube's apparent radius strays from the picture's.
    """

    normal_matrix: NDArray[np.float64]
    inverse: NDArray[np.float64]
    gain_prior: float
    radius_sigma_px: float


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
    """Measure the tubes at `sheet_mm`, (n, 2) nominal places, n >= 1, predicted to within REACH edge widths.

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
    count = rays or _rays(2 * math.pi * lattice.rim_radius_mm * scale)
    resolved = max((lattice.outer_radius_mm - lattice.rim_radius_mm) * scale / profile.width_px, 1e-3)
    edge, foot, functionals = _windows(profile, resolved)
    dots, normal = np.empty((n, count, 8), np.float32), np.empty((n, count, 2))
    valid, mean = np.empty((n, count), np.bool_), np.empty((n, SAMPLES))
    center, slope, out = np.empty((n, 2)), np.zeros((n, 2)), np.zeros((n, 11))
    _sample(
        image, vector, rotation, translation_mm, sheet_mm, lattice.rim_radius_mm, _circle(count),
        profile.offsets_px, functionals, dots, normal, center, valid, mean,
    )  # fmt: skip
    _levels_of(dots, valid, edge.normal_matrix, out)
    _light_slopes(center, aspect, out, SLOPE_REACH * lattice.pitch_mm * scale, lattice.rim_radius_mm * scale, slope)
    _solve(
        dots, normal, valid, np.arange(n), 0, edge.normal_matrix, edge.inverse, edge.gain_prior, slope, aspect,
        edge.radius_sigma_px, REACH * profile.width_px, out,
    )  # fmt: skip
    light = slope * [profile.width_px, profile.width_px / aspect]
    shift = out[:, 0:2] + light_shift(profile.width_px) * light
    return Rims(
        center_px=center + shift, radius_px=out[:, 10], covariance_px=out[:, 2:5], gain=out[:, 5], bore=out[:, 6],
        outside=out[:, 7], strength=out[:, 8], rays=out[:, 9], light_px=light, shift_px=shift,
        seen=Seen(dots, normal, valid, mean, slope, aspect, profile, edge, foot),
    )  # fmt: skip


def solve_feet(rims: Rims, which: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Solve for the shift of the tubes `which` with the least bias: the foot of the edge alone.

    Nothing beyond the edge reaches it, such as a glint on the weld bead, and each ray's offset is its own. It is
    noisier, and serves to tell what all the others have in common.

    Returns
    -------
    shift_px, covariance_px, quality
        (m, 2), (m, 3) as in `Rims`, and (m, 2): strength and share of rays.
    """
    seen, foot = rims.seen, rims.seen.foot
    width = seen.profile.width_px
    out = np.zeros((len(which), 11))
    out[:, 5], out[:, 6] = rims.gain[which], rims.bore[which]
    out[:, 8], out[:, 9] = rims.strength[which], rims.rays[which]
    _solve(
        seen.dots, seen.normal, seen.valid, which, 3, foot.normal_matrix, foot.inverse, foot.gain_prior, seen.slope,
        seen.aspect, foot.radius_sigma_px, REACH * width, out,
    )  # fmt: skip
    return out[:, 0:2] + light_shift(width) * rims.light_px[which], out[:, 2:5], out[:, 8:10]


def _windows(profile: EdgeProfile, resolved: float) -> tuple[Window, Window, NDArray[np.float32]]:
    """The two ways of weighing a ray, least noise and least bias; and what samples are multiplied with, (6, SAMPLES).

    `resolved` is the width of the tube wall over that of the edge's blur: what lies beyond an unresolved wall must not
    be taken for its own brightness.
    """
    edge_gain = min(max((2.05 / resolved) ** 5.2, 0.003), 30.0)
    foot_gain = min((1.45 / resolved) ** 4.1, 30.0)
    width = profile.width_px
    functionals = np.empty((6, SAMPLES), np.float32)
    edge, foot = np.empty((2, 3, 3)), np.empty((2, 3, 3))
    _weigh(profile.template, width, EDGE, OFFSET_PRIOR, edge_gain, functionals[0:3], edge)
    _weigh(profile.template, width, FOOT, 0.0, foot_gain, functionals[3:6], foot)
    return (
        Window(edge[0], edge[1], edge_gain, RADIUS_SIGMA * width),
        Window(foot[0], foot[1], foot_gain, FOOT_RADIUS_SIGMA * width),
        functionals,
    )


@compiled
def _weigh(
    T: Array, width: float, weight: Array, offset_prior: float, gain_prior: float, functionals: NDArray[np.float32],
    out: Array,
) -> None:  # fmt: skip
    """Functionals of the basis (1, T, -T') under a window; its normal matrix, and the inverse with the priors added."""
    last = T.shape[0] - 1
    M = np.zeros((3, 3))
    row = np.empty(3)
    for j in range(T.shape[0]):
        left, right = max(j - 1, 0), min(j + 1, last)
        row[0], row[1], row[2] = 1.0, T[j], -(T[right] - T[left]) / (width * (GRID[right] - GRID[left]))
        for p in range(3):
            functionals[p, j] = weight[j] * row[p]
            for q in range(3):
                M[p, q] += weight[j] * row[p] * row[q]
    out[0] = M
    M[0, 0] *= 1.0 + offset_prior
    M[1, 1] *= 1.0 + gain_prior
    for p in range(3):  # cofactors
        a, b = (p + 1) % 3, (p + 2) % 3
        for q in range(3):
            c, d = (q + 1) % 3, (q + 2) % 3
            out[1, q, p] = M[a, c] * M[b, d] - M[a, d] * M[b, c]
    out[1] /= M[0, 0] * out[1, 0, 0] + M[0, 1] * out[1, 1, 0] + M[0, 2] * out[1, 2, 0]


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
def _circle(count: int) -> Array:
    """Cosine and sine of `count` angles around a circle, and of twice those, (4, count)."""
    a = 2 * np.pi * np.arange(count) / count
    return np.array([np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)])


def _rays(circumference_px: float) -> int:
    """How many rays a rim deserves; a multiple of four, so that few sizes occur."""
    return min(max(4 * round(circumference_px / RAY_SPACING_PX / 4), FEWEST_RAYS), MOST_RAYS)


@compiled
def _sample(
    image: Image, v: Array, R: Array, t: Array, sheet_mm: Array, radius_mm: float, circle: Array, offsets: Array,
    functionals: NDArray[np.float32], dots: NDArray[np.float32], normal: Array, center: Array,
    valid: NDArray[np.bool_], mean: Array,
) -> None:  # fmt: skip
    """Sample along the normals of projected circles, bilinear; a ray that leaves the picture is not valid."""
    h, w = image.shape
    count, last = circle.shape[1], offsets.shape[0] - 1
    aspect = v[0] / v[1]
    wave, ray = np.empty((2, 5)), np.empty((4, count))
    scratch, place, u = np.empty((6, SAMPLES), np.float32), np.empty(SAMPLES, np.int32), offsets.astype(np.float32)
    grey, total = np.empty(SAMPLES, np.float32), np.empty(SAMPLES, np.float32)
    for i in range(sheet_mm.shape[0]):
        center[i, 0], center[i, 1] = project_point(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], 0.0)
        sign = _project_circle(v, R, t, sheet_mm[i, 0], sheet_mm[i, 1], radius_mm, wave)
        if math.isnan(center[i, 0]) or sign == 0.0:
            valid[i] = False
            continue
        seen = 0
        total[:] = 0.0
        _directions(wave, circle, sign, aspect, ray)
        for k in range(count):
            x, y, nx, ny = ray[0, k], ray[1, k], ray[2, k], ray[3, k]
            normal[i, k, 0], normal[i, k, 1] = nx, aspect * aspect * ny
            x0, x1 = x + offsets[0] * nx, x + offsets[last] * nx
            y0, y1 = y + offsets[0] * ny, y + offsets[last] * ny
            inside = min(x0, x1) >= 0.0 and max(x0, x1) < w - 1.01 and min(y0, y1) >= 0.0 and max(y0, y1) < h - 1.01
            valid[i, k] = inside
            if inside:
                seen += 1
                _along(image, x, y, nx, ny, u, place, scratch, grey)
                _condense(grey, functionals, dots[i, k])
                for j in range(SAMPLES):
                    total[j] += grey[j]
        for j in range(SAMPLES):
            mean[i, j] = total[j] / max(seen, 1)


@compiled
def _directions(wave: Array, circle: Array, sign: float, aspect: float, ray: Array) -> None:
    """Points of a projected circle and its normals there, rows x, y, nx, ny: one px of x along them is one px long.

    The normal is that on the sensor: blur and edge are round there, not in a field's lines.
    """
    for k in range(circle.shape[1]):
        c1, s1, c2, s2 = circle[0, k], circle[1, k], circle[2, k], circle[3, k]
        ray[0, k] = wave[0, 0] + wave[0, 1] * c1 + wave[0, 2] * s1 + wave[0, 3] * c2 + wave[0, 4] * s2
        ray[1, k] = wave[1, 0] + wave[1, 1] * c1 + wave[1, 2] * s1 + wave[1, 3] * c2 + wave[1, 4] * s2
        tx = wave[0, 2] * c1 - wave[0, 1] * s1 + 2.0 * (wave[0, 4] * c2 - wave[0, 3] * s2)
        ty = aspect * (wave[1, 2] * c1 - wave[1, 1] * s1 + 2.0 * (wave[1, 4] * c2 - wave[1, 3] * s2))
        scale = sign / math.sqrt(tx * tx + ty * ty)
        ray[2, k], ray[3, k] = ty * scale, -tx * scale / aspect


@compiled
def _project_circle(v: Array, R: Array, t: Array, x: float, y: float, radius_mm: float, wave: Array) -> float:
    """Project a circle as a trigonometric polynomial of second order, (2, 5), through NODES of its points.

    Gives the sense it runs in, +1 or -1, or 0 where a point has no image.
    """
    for p in range(5):
        wave[0, p], wave[1, p] = 0.0, 0.0
    for j in range(NODES):
        px, py = project_point(v, R, t, x + radius_mm * NODE_WAVES[j, 1], y + radius_mm * NODE_WAVES[j, 2], 0.0)
        if math.isnan(px):
            return 0.0
        for p in range(5):
            share = (2.0 if p else 1.0) / NODES * NODE_WAVES[j, p]
            wave[0, p] += share * px
            wave[1, p] += share * py
    return 1.0 if wave[0, 1] * wave[1, 2] - wave[0, 2] * wave[1, 1] > 0.0 else -1.0


@compiled
def _along(
    image: Image, x: float, y: float, nx: float, ny: float, offsets: NDArray[np.float32], place: NDArray[np.int32],
    scratch: NDArray[np.float32], grey: NDArray[np.float32],
) -> None:  # fmt: skip
    """Bilinear grey values at (x, y) + offsets * n; in three loops, of which two run eight at a time."""
    width = np.int32(image.shape[1])
    flat = image.reshape(-1)
    x0, y0, dx, dy = np.float32(x), np.float32(y), np.float32(nx), np.float32(ny)
    fx, fy, p, q, r, s = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5]
    for j in range(SAMPLES):
        xs, ys = x0 + offsets[j] * dx, y0 + offsets[j] * dy
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
def _condense(grey: NDArray[np.float32], functionals: NDArray[np.float32], dots: NDArray[np.float32]) -> None:
    """A ray's eight numbers, see `Seen`; each sum runs over the samples of its window only."""
    e0, e1, e2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    f0, f1, f2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for j in range(EDGE_FROM, EDGE_TO):
        e0 += functionals[0, j] * grey[j]
        e1 += functionals[1, j] * grey[j]
        e2 += functionals[2, j] * grey[j]
    for j in range(FOOT_TO):
        f0 += functionals[3, j] * grey[j]
        f1 += functionals[4, j] * grey[j]
        f2 += functionals[5, j] * grey[j]
    dots[0], dots[1], dots[2], dots[3], dots[4], dots[5] = e0, e1, e2, f0, f1, f2
    dots[6] = (grey[0] + grey[1] + grey[2]) / np.float32(INNER)
    dots[7] = (grey[SAMPLES - 2] + grey[SAMPLES - 1]) / np.float32(2.0)


@compiled
def _levels_of(dots: NDArray[np.float32], valid: NDArray[np.bool_], M: Array, out: Array) -> None:
    """Levels, height of the edge and strength of each tube, into `out`: the columns are those of `Rims`.

    They are shift x, y; covariance xx, xy, yy; gain, bore, outside, strength, rays, radius.
    """
    count = dots.shape[1]
    work = np.empty(count)
    edge = M[1, 1] * M[2, 2] - M[1, 2] * M[1, 2]
    for i in range(dots.shape[0]):
        o = out[i]
        o[8] = -1.0
        n = 0
        for k in range(count):
            if valid[i, k]:
                work[n] = dots[i, k, 6]
                n += 1
        if n < LEAST_RAYS:
            continue
        bore, _ = clipped_mean(work, n)
        n = 0
        for k in range(count):
            if valid[i, k]:
                work[n] = dots[i, k, 7]
                n += 1
        outside, _ = clipped_mean(work, n)
        n = 0
        for k in range(count):
            if valid[i, k]:
                b, c = dots[i, k, 1] - bore * M[0, 1], dots[i, k, 2] - bore * M[0, 2]
                work[n] = (b * M[2, 2] - c * M[1, 2]) / edge
                n += 1
        gain, stray = clipped_mean(work, n)
        o[5], o[6], o[7] = gain, bore, outside
        o[8] = gain * math.sqrt(n) / (1.25 * stray + 1e-6)
        o[9] = n / count


@compiled
def _light_slopes(center: Array, aspect: float, out: Array, reach: float, radius: float, slope: Array) -> None:
    """How the light changes from each tube's centre to its rim: slope of the logarithm of its neighbours' gains.

    A plane through the neighbours, drawn towards level light; one reweighting sets stained tubes aside. Tubes are
    looked up in square cells as wide as the reach.
    """
    n = center.shape[0]
    tells = np.empty(n, np.bool_)
    log = np.empty(n)
    right, bottom = 0.0, 0.0
    for i in range(n):
        tells[i] = out[i, 8] >= SLOPE_STRENGTH and center[i, 0] > -reach and center[i, 1] > -reach
        if tells[i]:
            log[i] = math.log(out[i, 5])
            right, bottom = max(right, center[i, 0]), max(bottom, center[i, 1] * aspect)
    across, down = int(right / reach) + 4, int(bottom / reach) + 4
    first, next_one = np.full(across * down, -1, np.int64), np.empty(n, np.int64)
    for i in range(n):
        if tells[i]:
            cell = (int(center[i, 1] * aspect / reach + 1.0) + 1) * across + int(center[i, 0] / reach + 1.0) + 1
            next_one[i] = first[cell]
            first[cell] = i
    for i in range(n):
        if not tells[i]:
            continue
        x0, y0 = center[i, 0], center[i, 1] * aspect
        cx, cy = int(x0 / reach + 1.0) + 1, int(y0 / reach + 1.0) + 1
        a, bx, by = log[i], 0.0, 0.0
        for step in range(2):
            s0, sx, sy, sxx, sxy, syy, t0, tx, ty = 0.0, 0.0, 0.0, SLOPE_PRIOR, 0.0, SLOPE_PRIOR, 0.0, 0.0, 0.0
            for row in range(cy - 1, cy + 2):
                for col in range(cx - 1, cx + 2):
                    if row < 0 or col < 0 or row >= down or col >= across:
                        continue
                    j = first[row * across + col]
                    while j >= 0:
                        dx, dy = (center[j, 0] - x0) / reach, (center[j, 1] * aspect - y0) / reach
                        d2 = dx * dx + dy * dy
                        z = log[j]
                        r = (z - a - bx * dx - by * dy) / SLOPE_STRAY if step else 0.0
                        if d2 < 1.0 and r * r < 1.0:
                            w = ((1.0 - d2) * (1.0 - r * r)) ** 2
                            s0 += w
                            sx += w * dx
                            sy += w * dy
                            sxx += w * dx * dx
                            sxy += w * dx * dy
                            syy += w * dy * dy
                            t0 += w * z
                            tx += w * z * dx
                            ty += w * z * dy
                        j = next_one[j]
            if s0 < 2.0:
                bx, by = 0.0, 0.0
                break
            vxx, vxy, vyy = sxx - sx * sx / s0, sxy - sx * sy / s0, syy - sy * sy / s0
            ux, uy = tx - sx * t0 / s0, ty - sy * t0 / s0
            det = vxx * vyy - vxy * vxy
            bx, by = (vyy * ux - vxy * uy) / det, (vxx * uy - vxy * ux) / det
            a = (t0 - bx * sx - by * sy) / s0
        slope[i, 0], slope[i, 1] = bx * radius / reach, by * radius / reach


@compiled
def _solve(
    dots: NDArray[np.float32], normal: Array, valid: NDArray[np.bool_], which: NDArray[np.int64], base: int, M: Array,
    Q: Array, gain_prior: float, slope: Array, aspect: float, radius_sigma: float, reach: float, out: Array,
) -> None:  # fmt: skip
    """Shift, radius and covariance of the tubes `which` from their rays, into `out`, which holds the levels already.

    `base` is where the window's three dots stand; see `Seen` and `Window`.
    """
    count = dots.shape[1]
    work, shift, weight = np.empty(count), np.empty(count), np.empty(count)
    for row in range(which.shape[0]):
        i, o = which[row], out[row]
        gain, bore = o[5], o[6]
        if gain <= 0.0 or o[9] == 0.0:
            continue
        for k in range(count):  # each ray's shift; brighter rays count more, up to a limit
            weight[k] = 0.0
            if not valid[i, k]:
                continue
            expected = gain * max(1.0 + slope[i, 0] * normal[i, k, 0] + slope[i, 1] * normal[i, k, 1] / aspect, 0.3)
            a = dots[i, k, base] - bore * M[0, 0]
            b = dots[i, k, base + 1] - bore * M[0, 1] + gain_prior * M[1, 1] * expected
            c = dots[i, k, base + 2] - bore * M[0, 2]
            g = Q[1, 0] * a + Q[1, 1] * b + Q[1, 2] * c
            gs = Q[2, 0] * a + Q[2, 1] * b + Q[2, 2] * c
            if g > LEAST_GAIN * gain and abs(gs) < reach * g:
                shift[k] = gs / g
                weight[k] = min(g / gain, 1.5) ** 2
        if not _circle_fit(normal[i], shift, weight, radius_sigma, work, o):
            o[8] = -1.0


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


def profile_of(rims: Rims) -> EdgeProfile | None:
    """The mean edge of the clearest tubes, placed and scaled anew; None where too few show one."""
    clear = np.flatnonzero((rims.strength > 20) & (rims.rays > 0.6))
    if len(clear) < 4:
        clear = np.argsort(-rims.strength)[: max(4, len(rims.strength) // 5)]
        clear = clear[rims.strength[clear] > 5]
    if len(clear) < 4:
        return None
    profile = _median_profile(rims.seen.mean, rims.bore.copy(), rims.gain.copy(), clear)
    profile -= profile[:INNER].mean()
    top = float(profile[:TOP].max())
    foot, half = _crossing(profile, 0.16 * top), _crossing(profile, 0.5 * top)
    if foot is None or half is None or half <= foot:
        return None
    offsets = rims.seen.profile.offsets_px
    position = float(np.interp(half, np.arange(SAMPLES), offsets))
    width = float(position - np.interp(foot, np.arange(SAMPLES), offsets))
    width = min(max(width, WIDTH_LIMITS_PX[0]), WIDTH_LIMITS_PX[1])
    return EdgeProfile(position, width, np.interp(position + width * GRID, offsets, profile / top))


@compiled
def _median_profile(mean: Array, bore: Array, gain: Array, clear: NDArray[np.int64]) -> Array:
    """Median over tubes of their mean profiles, each from 0 in the bore to 1."""
    profile, work = np.empty(mean.shape[1]), np.empty(clear.shape[0])
    for j in range(mean.shape[1]):
        for k in range(clear.shape[0]):
            i = clear[k]
            work[k] = (mean[i, j] - bore[i]) / gain[i]
        profile[j] = median_in_place(work, clear.shape[0])
    return profile


def _crossing(profile: Array, level: float) -> float | None:
    """Where the profile first rises through `level`, in samples."""
    k = int(np.argmax(profile > level))
    if k == 0:
        return None
    return k - 1 + float((level - profile[k - 1]) / (profile[k] - profile[k - 1]))
