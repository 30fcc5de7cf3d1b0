"""Draws a tubesheet as the simulated camera sees it.

Every pixel's ray is followed to the sheet, so the lens needs no warping. A pixel on an edge gets the exact share of its
square that lies on either side of the edge's tangent, so the truth holds to a few thousandths of a pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import cv2
import numpy as np

from drivers.scene import ABSENT, PLUGGED

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from drivers.frame import Pixels
    from drivers.optics import Optics
    from drivers.scene import Look, Sheet

    Image: TypeAlias = NDArray[Any]  # float32, (height, width)

__all__ = ["Renderer", "add_noise", "quantised"]

STRIP_ROWS = 48  # a strip's arrays stay in the cache
GRAZING = 0.05  # cosine below which a ray counts as missing the sheet
FAR_MM = np.float32(1e6)
LAMP_SLOPE, GLARE_SLOPE = 0.02, 0.06  # where the lamp's mirror image stands, and its radius; mm a mm
TEXELS, TEXELS_PER_MM = 1024, 2.0
HOSE = 0.05


class Renderer:
    """Draws one sheet through one camera.

    Parameters
    ----------
    optics
        The camera.
    sheet
        Tubes and hose.
    look
        Brightness, light, blur.
    rng
        For the plate's texture.
    """

    def __init__(self, optics: Optics, sheet: Sheet, look: Look, rng: np.random.Generator) -> None:
        self._optics, self._sheet, self._look = optics, sheet, look
        rays = optics.rays(margin=1)  # a pixel more all round, for derivatives
        self._seen = np.isfinite(rays[1:-1, 1:-1, 0]).astype(np.float32)
        self._rays: Image = np.nan_to_num(rays)
        self._origin = sheet.centers_mm[..., :2].reshape(-1, 2).mean(axis=0)  # small numbers keep float32 exact
        self._sites = self._site_table()
        self._light = self._lamp() * self._seen
        self._texture = _texture(look.texture, rng)

    def _site_table(self) -> Image:
        """(rows, columns, 4): centre and height of a rim, and its gloss: negative for a plug, 0 where no tube is."""
        sheet = self._sheet
        table = np.empty((*sheet.states.shape, 4), np.float32)
        table[..., :2] = sheet.centers_mm[..., :2] - self._origin
        table[..., 2] = sheet.centers_mm[..., 2]
        table[..., 3] = np.where(sheet.states == PLUGGED, -sheet.gloss, sheet.gloss)
        table[sheet.states == ABSENT, 3] = 0
        return table

    def _lamp(self) -> Image:
        """Light on every pixel: the lamp stands beside the lens, so its spot stays where it is in the picture."""
        w, h, look = self._optics.width_px, self._optics.height_px, self._look
        if math.isinf(look.spot):
            return np.ones((h, w), np.float32)
        v, u = np.mgrid[:h, :w].astype(np.float32)
        q = ((u - 0.55 * w) ** 2 + (v - 0.52 * h) ** 2) / (look.spot * w) ** 2
        return np.asarray(look.ambient + (1 - look.ambient) * np.exp(-q / 2), dtype=np.float32)

    def draw(self, rotation: NDArray[np.float64], translation_mm: NDArray[np.float64]) -> Image:
        """Draw the noise-free picture, (height, width), 0 dark and 1 full scale, from a camera at Xc = R Xw + t."""
        h, w = self._light.shape
        image = np.empty((h, w), np.float32)
        for top in range(0, h, STRIP_ROWS):
            self._draw_strip(image, top, min(top + STRIP_ROWS, h), rotation, translation_mm)
        if self._sheet.hose is not None:
            cover = self.hose_cover(rotation, translation_mm).astype(np.float32) / 255
            image += cover * (HOSE * self._light - image)
        return _blurred(image, self._look.blur_px)

    def _draw_strip(
        self, image: Image, top: int, bottom: int, rotation: NDArray[np.float64], translation_mm: NDArray[np.float64]
    ) -> None:
        rays = self._meet_sheet(top, bottom, rotation, translation_mm)
        light: Image = self._light[top:bottom]
        if self._look.glare:
            light = light + self._glare(rays) * self._seen[top:bottom]
        np.multiply(self._shade(rays), light, out=image[top:bottom])

    def _meet_sheet(
        self, top: int, bottom: int, rotation: NDArray[np.float64], translation_mm: NDArray[np.float64]
    ) -> _Rays:
        """Follow the rays of some rows to Z = 0 and to the rim's plane of the nearest tube."""
        camera = -rotation.T @ translation_mm
        dx, dy, dz = cv2.split(cv2.transform(self._rays[top : bottom + 2], rotation.T))
        dz = np.maximum(dz, np.float32(GRAZING))
        wide_x, wide_y = dx / dz, dy / dz
        slope_x, slope_y = wide_x[1:-1, 1:-1], wide_y[1:-1, 1:-1]
        x0, y0 = (camera[:2] - self._origin).astype(np.float32)
        z0 = np.float32(camera[2])
        x, y = x0 - z0 * slope_x, y0 - z0 * slope_y
        center_x, center_y, z, gloss = cv2.split(self._nearest_site(x, y))
        qx, qy = x + z * slope_x - center_x, y + z * slope_y - center_y
        r = np.where(gloss == 0, FAR_MM, cv2.magnitude(qx, qy))
        return _Rays(x, y, slope_x, slope_y, qx, qy, r, gloss, z - z0, wide_x, wide_y)

    def _nearest_site(self, x: Image, y: Image) -> Image:
        """Entries of the site table, (height, width, 4), by rounding the lattice coordinates of points of the sheet."""
        inverse = np.linalg.inv(self._sheet.lattice.basis_mm).astype(np.float32)
        first_row, first_column = self._sheet.first
        column0, row0 = (self._origin @ inverse - (first_column, first_row)).astype(np.float32)
        column = x * inverse[0, 0] + y * inverse[1, 0] + column0
        row = x * inverse[0, 1] + y * inverse[1, 1] + row0
        # beyond the border the nearest site is far enough away to draw nothing
        site: Image = cv2.remap(self._sites, column, row, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        return site

    def _shade(self, rays: _Rays) -> Image:
        """Plate, weld bead, tube end and bore or plug, each covering what lies outside it."""
        look, lattice, r = self._look, self._sheet.lattice, rays.r
        image = np.full_like(r, look.plate)
        if look.texture:
            u, v = rays.x * TEXELS_PER_MM, rays.y * TEXELS_PER_MM
            image *= cv2.remap(self._texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        if look.weld_mm > 0:
            lit = 1 + 0.3 * (rays.qx * np.float32(0.8) + rays.qy * np.float32(0.6)) / np.maximum(r, 1)
            bead_mm = min(lattice.outer_radius_mm + look.weld_mm, lattice.widest_mm)
            image += rays.inside(bead_mm) * (look.weld * lit - image)
        image += rays.inside(lattice.outer_radius_mm) * (look.rim * np.abs(rays.gloss) - image)
        face = np.float32(look.plug) * (1 - 0.2 * (np.cos(r * np.float32(7 / lattice.rim_radius_mm)) > 0))
        core = np.where(rays.gloss < 0, face, self._wall(rays) if look.wall else np.float32(0))
        image += rays.inside(lattice.rim_radius_mm) * (core - image)
        return image

    def _wall(self, rays: _Rays) -> Image:
        """Light on the bore's wall where the ray meets it: |q + z s| = rim radius."""
        s2 = rays.slope_x * rays.slope_x + rays.slope_y * rays.slope_y + np.float32(1e-9)
        b = rays.qx * rays.slope_x + rays.qy * rays.slope_y
        room = np.maximum(np.float32(self._sheet.lattice.rim_radius_mm**2) - rays.r * rays.r, 0)
        depth_mm = (cv2.sqrt(b * b + s2 * room) - b) / s2
        light: Image = cv2.exp(depth_mm * np.float32(-1 / self._look.wall_depth_mm))
        return light * np.float32(self._look.wall)

    def _glare(self, rays: _Rays) -> Image:
        """The lamp mirrored in the sheet: brightest where the ray meets it at a right angle."""
        off = (rays.slope_x - np.float32(LAMP_SLOPE)) ** 2 + rays.slope_y * rays.slope_y
        light: Image = cv2.exp(off * np.float32(-0.5 / GLARE_SLOPE**2))
        return light * np.float32(self._look.glare)

    def hose_cover(self, rotation: NDArray[np.float64], translation_mm: NDArray[np.float64]) -> NDArray[np.uint8]:
        """How much of each pixel the hose covers, (height, width), 255 all."""
        cover = np.zeros(self._light.shape, np.uint8)
        hose = self._sheet.hose
        if hose is None:
            return cover
        points = self._optics.project(rotation, translation_mm, hose.points_mm)
        depth = hose.points_mm @ rotation[2] + translation_mm[2]
        good = np.isfinite(points).all(axis=1) & (np.abs(points) < 20_000).all(axis=1)
        if good.sum() < 2:
            return cover
        width_px = 2 * hose.radius_mm * self._optics.matrix[0, 0] / float(np.median(depth[good]))
        line = np.rint(points[good] * 16).astype(np.int32)[None]
        cv2.polylines(
            cover,
            list(line),
            isClosed=False,
            color=255,
            thickness=max(1, round(width_px)),
            lineType=cv2.LINE_AA,
            shift=4,
        )
        return cover


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Some rows of pixels on the sheet; mm, from the renderer's origin.

    x, y on Z = 0; slope_x, slope_y a mm of Z; qx, qy, r from the nearest tube's axis in its rim's plane (r far off
    where there is no tube); its gloss; plunge: from the camera to that plane along Z; wide_x, wide_y: the slopes, and a
    pixel more all round.
    """

    x: Image
    y: Image
    slope_x: Image
    slope_y: Image
    qx: Image
    qy: Image
    r: Image
    gloss: Image
    plunge: Image
    wide_x: Image
    wide_y: Image

    def inside(self, radius_mm: float) -> Image:
        """Share of each pixel inside a circle about the tube's axis."""
        share: Image = (self.r < radius_mm).astype(np.float32)
        edge = np.flatnonzero(np.abs(self.r - np.float32(radius_mm)) < self._half_diagonal_mm())
        r, gu, gv = self._slope_of_r(edge)
        steep = np.maximum(np.sqrt(gu * gu + gv * gv), np.float32(1e-9))
        depth_px = (np.float32(radius_mm) - r) / steep
        share.ravel()[edge] = _covered(depth_px, np.abs(gu) / steep, np.abs(gv) / steep)
        return share

    def _half_diagonal_mm(self) -> float:
        """How far from a pixel's centre its square may reach on the sheet: half its longest diagonal, a little more."""
        some = slice(None, None, 8)
        across = np.hypot(np.diff(self.wide_x[:, some], axis=0), np.diff(self.wide_y[:, some], axis=0)).max()
        along = np.hypot(np.diff(self.wide_x[some], axis=1), np.diff(self.wide_y[some], axis=1)).max()
        return 0.55 * float(np.abs(self.plunge).max()) * math.hypot(across, along) + 1e-6

    def _slope_of_r(self, at: NDArray[np.int_]) -> tuple[Image, Image, Image]:
        """r, dr/du and dr/dv, mm a px, at some pixels: central differences of the slopes, the tube held fast."""
        width = self.r.shape[1]
        row, column = np.divmod(at, width)
        wide = (row + 1) * (width + 2) + column + 1
        r, qx, qy = (a.ravel()[at] for a in (self.r, self.qx, self.qy))
        scale = self.plunge.ravel()[at] / (2 * np.maximum(r, np.float32(1e-6)))
        steps = []
        for step in (1, width + 2):
            x, y = (a.ravel()[wide + step] - a.ravel()[wide - step] for a in (self.wide_x, self.wide_y))
            steps.append((qx * x + qy * y) * scale)
        return r, steps[0], steps[1]


def _covered(depth_px: Image, nu: Image, nv: Image) -> Image:
    """Share of a unit square behind a line with normal (nu, nv), both >= 0, its centre `depth_px` behind it."""
    a, b = (np.maximum(n, np.float32(1e-6)) for n in (np.maximum(nu, nv), np.minimum(nu, nv)))
    t = np.abs(depth_px)
    corner = np.maximum((a + b) / 2 - t, 0)
    half = np.where(t <= (a - b) / 2, t / a, np.float32(0.5) - corner * corner / (2 * a * b))
    return np.float32(0.5) + np.copysign(half, depth_px)


def _blurred(image: Image, sigma_px: float) -> Image:
    return cv2.GaussianBlur(image, (0, 0), sigma_px) if sigma_px > 0 else image


def _texture(contrast: float, rng: np.random.Generator) -> Image:
    """A periodic picture of stains and machining marks about 1."""
    if not contrast:
        return np.ones((1, 1), np.float32)
    fx = np.fft.rfftfreq(TEXELS)[None, :]
    fy = np.fft.fftfreq(TEXELS)[:, None]
    stains = 1 / (1 + ((fx * fx + fy * fy) * 300.0**2)) ** 0.75
    marks = 0.04 * np.exp(-((fy * 80) ** 2) - (fx * 4) ** 2)
    white = np.fft.rfft2(rng.standard_normal((TEXELS, TEXELS)))
    texture = np.fft.irfft2(white * (stains + marks), s=(TEXELS, TEXELS))
    return np.asarray(np.clip(1 + contrast * texture / texture.std(), 0.3, 1.8), dtype=np.float32)


def add_noise(image: Image, look: Look, rng: np.random.Generator) -> Image:
    """Add the sensor's noise and radiation specks to a picture in 0..1."""
    if look.read_noise or look.shot_noise:
        variance = np.maximum(image, 0) * np.float32((look.shot_noise / 255) ** 2)
        variance += np.float32((look.read_noise / 255) ** 2)
        image = image + cv2.sqrt(variance) * rng.standard_normal(image.shape, dtype=np.float32)
    for _ in range(rng.poisson(look.specks)):
        x, y = rng.uniform(0, image.shape[1]), rng.uniform(0, image.shape[0])
        length, angle = rng.exponential(2.0), rng.uniform(0, math.tau)
        end = (round(x + length * math.cos(angle)), round(y + length * math.sin(angle)))
        cv2.line(image, (round(x), round(y)), end, float(rng.uniform(0.5, 1.2)))
    return image


def quantised(image: Image, bits: int) -> Pixels:
    """Grey values of a picture in 0..1, read-only."""
    levels = np.rint(np.clip(image, 0, 1) * np.float32((1 << bits) - 1))
    pixels: Pixels = levels.astype(np.uint8) if bits == 8 else levels.astype(np.uint16)
    pixels.flags.writeable = False
    return pixels
