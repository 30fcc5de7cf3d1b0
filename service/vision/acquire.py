"""Find the sheet with nothing to go by: blobs, indices, pose; coarse to fine until one proves itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np

from service.vision.detection import DISC_RADIUS_PX, Blobs, find_blobs
from service.vision.indexing import UNINDEXED, index_blobs
from service.vision.motion import looked_at
from service.vision.pose import Fit, fit_pose, pose_from_plane, prior_of
from service.vision.projection import undistort

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.pose import Prior
    from service.vision.stopwatch import Stopwatch

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Candidate", "candidates"]

LEVEL = 1.45
"""Step between the radii that are tried: half of it either way is what detection and indexing tolerate."""
SMALLEST_PX = 4.0
LARGEST = 0.18
"""Largest rim radius that is tried, as a share of the picture's shorter side."""
LEAST_INDEXED = 9
CLEAR = 30.0
"""Merit (blobs indexed, times the square of their share) from which a scale may be the right one."""
BLOB_SIGMA = 0.12
"""One sigma of a blob's centre, in rim radii."""
SAME_SITE = 0.25
"""How far from a lattice place, in lattice steps, a blob may stand and still be taken for it."""
FOCAL_STARTS = (0.7, 1.2, 2.2, 4.5)
"""Focal lengths to start from where none is known, in picture widths."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A lattice that the blobs of one scale suggest.

    Attributes
    ----------
    fit
        Pose (and camera) from the blobs' centres.
    radius_px
        Rim radius along x in the picture's middle, under that pose.
    indexed
        How many blobs it explains.
    blobs
        All blobs of that scale.
    """

    fit: Fit
    radius_px: float
    indexed: int
    blobs: Blobs


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """Blobs of one scale, indexed."""

    radius_px: float
    blobs: Blobs
    index: NDArray[np.int64]
    merit: float


def candidates(
    image: Image, camera: Camera, lattice: Lattice, watch: Stopwatch, hint_px: float | None = None
) -> Iterator[Candidate]:
    """Suggest poses, the likeliest first.

    Parameters
    ----------
    image
        (h, w) grey of `camera`: a frame, or one field with its field's camera.
    hint_px
        Rim radius along x, where an earlier picture told it: that scale alone is tried first.
    """
    tried: list[_Level] = []
    pyramid = _Pyramid(image)
    for radius in [hint_px] if hint_px else []:
        tried += _indexed_blobs(pyramid, radius, camera, lattice, watch)
    yield from _fitted(tried, camera, lattice, watch)
    levels: list[_Level] = []
    for radius in _radii(image, camera):
        levels += _indexed_blobs(pyramid, radius, camera, lattice, watch)
        best = max((level.merit for level in levels), default=0.0)
        if best > CLEAR and levels[-1].radius_px == radius and levels[-1].merit < best / 2:
            break  # finer blobs explain less: the scale was passed
    levels.sort(key=lambda level: -level.merit)
    yield from _fitted(levels, camera, lattice, watch)


def _radii(image: Image, camera: Camera) -> list[float]:
    """Rim radii to try, largest first: their pictures are the smallest."""
    h, w = image.shape
    largest = LARGEST * min(w, h * _height_of_pixel(camera))
    if largest < SMALLEST_PX / LEVEL:
        return []
    count = max(1, math.floor(math.log(largest / SMALLEST_PX) / math.log(LEVEL)))
    return [largest / LEVEL**k for k in range(count + 1)]


def _height_of_pixel(camera: Camera) -> float:
    """Height of a pixel over its width: 2 in a field."""
    return camera.pixel_pitch_mm[1] / camera.pixel_pitch_mm[0]


def _indexed_blobs(
    pyramid: _Pyramid, radius_px: float, camera: Camera, lattice: Lattice, watch: Stopwatch
) -> list[_Level]:
    """Find and index blobs of one scale; an empty list where they suggest no lattice."""
    ratio = _height_of_pixel(camera)
    picture, shrink = pyramid.at(radius_px)
    blobs = find_blobs(picture, (radius_px / shrink, radius_px / shrink / ratio))
    center = (blobs.center_px + 0.5) * shrink - 0.5
    watch.lap("detect")
    if len(center) < LEAST_INDEXED:
        return []
    pitch = radius_px * lattice.pitch_mm / lattice.rim_radius_mm
    index, count = index_blobs(center * [1.0, ratio], lattice, pitch)
    watch.lap("lattice")
    if count < LEAST_INDEXED:
        return []
    return [_Level(radius_px, Blobs(center, blobs.response), index, count * (count / len(center)) ** 2)]


def _fitted(levels: list[_Level], camera: Camera, lattice: Lattice, watch: Stopwatch) -> Iterator[Candidate]:
    for level in levels:
        fit = _fit_lattice(level.blobs.center_px, level.index, camera, lattice, level.radius_px)
        watch.lap("pose")
        if fit is None:
            continue
        v = fit.camera.vector()
        depth = float(fit.rotation[2, :2] @ looked_at(fit.rotation, fit.translation_mm) + fit.translation_mm[2])
        radius_px = lattice.rim_radius_mm * v[0] / depth
        yield Candidate(fit, radius_px, int((fit.weight > 0).sum()), level.blobs)


class _Pyramid:
    """Halved pictures, made when first asked for: a large picture is then shrunk from near its final size."""

    def __init__(self, image: Image) -> None:
        self._levels = [image]

    def at(self, radius_px: float) -> tuple[Image, float]:
        """The smallest level on which a disc of `radius_px` still has the detector's radius, and its shrink factor."""
        level = max(0, int(math.log2(max(radius_px / DISC_RADIUS_PX, 1.0))))
        while len(self._levels) <= level:
            last = self._levels[-1]
            even = last[: last.shape[0] // 2 * 2, : last.shape[1] // 2 * 2]
            size = even.shape[1] // 2, even.shape[0] // 2
            self._levels.append(cv2.resize(even, size, interpolation=cv2.INTER_AREA))  # type: ignore[arg-type]
        return self._levels[level], float(2**level)


def _fit_lattice(
    center_px: Array, index: NDArray[np.int64], camera: Camera, lattice: Lattice, radius_px: float
) -> Fit | None:
    """Pose from indexed blobs; then all blobs are indexed anew by where they fall, which bridges lanes and gaps."""
    known = index[:, 0] != UNINDEXED
    best: Fit | None = None
    for start, prior in _starts(camera):
        fit = _fit_indexed(center_px[known], index[known], start, lattice, prior, radius_px)
        for _ in range(3):
            if fit is None:
                break
            again, ok = _reindexed(center_px, fit, lattice)
            if ok.sum() < LEAST_INDEXED:
                fit = None
                break
            fit = _fit_indexed(center_px[ok], again[ok], fit.camera, lattice, prior, radius_px, fit)
        if fit is not None and (best is None or _merit(fit) > _merit(best)):
            best = fit
    return best


def _merit(fit: Fit) -> float:
    """Blobs explained, less where they fit badly."""
    return float(fit.weight.sum()) / max(fit.scatter_factor, 0.5)


def _starts(camera: Camera) -> Iterator[tuple[Camera, Prior]]:
    """Cameras to start from, each with the prior of what it leaves open."""
    if camera.focal_length_mm is not None:
        yield camera, prior_of(camera)
        return
    width_mm = camera.image_size_px[0] * camera.pixel_pitch_mm[0]
    for factor in FOCAL_STARTS:
        start = replace(camera, focal_length_mm=factor * width_mm)
        yield start, prior_of(camera, factor * width_mm)


def _fit_indexed(
    center_px: Array, index: NDArray[np.int64], camera: Camera, lattice: Lattice, prior: Prior, radius_px: float,
    start: Fit | None = None,
) -> Fit | None:  # fmt: skip
    sheet = lattice.sheet_points(index[:, 0], index[:, 1])
    if start is None:
        pose = pose_from_plane(sheet, undistort(camera.vector(), center_px))
        if pose is None:
            return None
    else:
        pose = start.rotation, start.translation_mm
    sigma = BLOB_SIGMA * radius_px
    ratio = camera.pixel_pitch_mm[0] / camera.pixel_pitch_mm[1]
    covariance = np.tile([sigma**2, 0.0, (sigma * ratio) ** 2], (len(sheet), 1))
    return fit_pose(sheet, center_px, covariance, camera, *pose, lattice, prior, iterations=25)


def _reindexed(center_px: Array, fit: Fit, lattice: Lattice) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Lattice index of every blob under a pose, and which of them stand near enough to their place, one a place."""
    ray = undistort(fit.camera.vector(), center_px)
    normal = fit.rotation[:, 2]
    depth = float(normal @ fit.translation_mm) / (ray @ normal[:2] + normal[2])
    point = np.column_stack([ray * depth[:, None], depth]) - fit.translation_mm
    place = lattice.lattice_coordinates((point @ fit.rotation)[:, :2])
    ok = np.isfinite(place).all(axis=1) & (depth > 0) & (np.abs(place) < -UNINDEXED / 2).all(axis=1)
    index = np.full(place.shape, UNINDEXED, np.int64)
    index[ok] = np.rint(place[ok]).astype(np.int64)
    off = np.where(ok, np.linalg.norm(np.where(ok[:, None], place - index, 0.0), axis=1), np.inf)
    order = np.argsort(off, kind="stable")
    _, first = np.unique(index[order], axis=0, return_index=True)
    alone = np.zeros(len(index), np.bool_)
    alone[order[first]] = True
    return index, ok & alone & (off < SAME_SITE)
