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
from service.vision.sites import lattice_places, numbered

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
"""How far from a lattice place, in pitches, a blob may stand and still be taken for it."""
REINDEXED = 3
"""How often, at the most, blobs are indexed anew."""
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
    """Suggest poses: of each scale on which most blobs form a lattice as soon as it is met, then of the others.

    Scales go from large to small, as the pictures of large ones are small, and a lattice that is a bit too coarse for
    its scale is as good as any.

    Parameters
    ----------
    image
        (h, w) grey of `camera`: a frame, or one field with its field's camera.
    hint_px
        Rim radius along x, where an earlier picture told it: that scale alone is tried first.
    """
    pyramid = _Pyramid(image)
    if hint_px:
        hinted = _indexed_blobs(pyramid, hint_px, camera, lattice, watch)
        if hinted is not None:
            yield from _fitted(hinted, camera, lattice, watch)
    waiting: list[_Level] = []
    best = 0.0
    for radius in _radii(image, camera):
        level = _indexed_blobs(pyramid, radius, camera, lattice, watch)
        if level is None:
            continue
        if level.merit > CLEAR:
            yield from _fitted(level, camera, lattice, watch)
        else:
            waiting.append(level)
        best = max(best, level.merit)
        if best > CLEAR and level.merit < best / 2:
            break  # finer blobs explain less: the scale was passed
    for level in sorted(waiting, key=lambda level: -level.merit):
        yield from _fitted(level, camera, lattice, watch)


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
) -> _Level | None:
    """Find and index blobs of one scale; None where they suggest no lattice."""
    ratio = _height_of_pixel(camera)
    picture, shrink = pyramid.at(radius_px)
    blobs = find_blobs(picture, (radius_px / shrink, radius_px / shrink / ratio))
    center = (blobs.center_px + 0.5) * shrink - 0.5
    watch.lap("detect")
    if len(center) < LEAST_INDEXED:
        return None
    pitch = radius_px * lattice.pitch_mm / lattice.rim_radius_mm
    index, count = index_blobs(center * [1.0, ratio], lattice, pitch)
    watch.lap("lattice")
    if count < LEAST_INDEXED:
        return None
    return _Level(radius_px, Blobs(center, blobs.response), index, count * (count / len(center)) ** 2)


def _fitted(level: _Level, camera: Camera, lattice: Lattice, watch: Stopwatch) -> Iterator[Candidate]:
    """Suggest the pose of one scale, if it has one."""
    fit = _fit_lattice(level.blobs.center_px, level.index, camera, lattice, level.radius_px)
    watch.lap("pose")
    if fit is None:
        return
    v = fit.camera.vector()
    depth = float(fit.rotation[2, :2] @ looked_at(fit.rotation, fit.translation_mm) + fit.translation_mm[2])
    if not depth > 0:
        return
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
    fits = [
        (fit, prior)
        for start, prior in _starts(camera)
        if (fit := _fit_indexed(center_px[known], index[known], start, lattice, prior, radius_px)) is not None
    ]
    if not fits:
        return None
    fit, prior = max(fits, key=lambda of: _merit(of[0]))
    for _ in range(REINDEXED):
        again, ok = _reindexed(center_px, fit, lattice)
        if ok.sum() < LEAST_INDEXED:
            return None
        if np.array_equal(ok, known) and np.array_equal(again[ok], index[known]):
            break
        index, known = again, ok
        refit = _fit_indexed(center_px[ok], again[ok], fit.camera, lattice, prior, radius_px, fit)
        if refit is None:
            return None
        fit = refit
    return fit


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
    vector, basis = fit.camera.vector(), lattice.basis_mm
    index, off = lattice_places(vector, fit.rotation, fit.translation_mm, basis, center_px)
    order = np.argsort(off, kind="stable")
    _, first = np.unique(numbered(index[order, 0], index[order, 1]), return_index=True)
    alone = np.zeros(len(index), np.bool_)
    alone[order[first]] = True
    return index, alone & (off < SAME_SITE * lattice.pitch_mm)
