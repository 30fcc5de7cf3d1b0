"""The paper's steps 1 to 5: from a grey picture to the contours of dark round regions.

Kept as published, for users who know it and to compare with; the live engine does not threshold.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Picture: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]
    Grey: TypeAlias = NDArray[np.float32]
    Mask: TypeAlias = NDArray[np.bool_]

__all__ = [
    "Contour",
    "Ellipse",
    "Threshold",
    "aspect_px",
    "binarize",
    "circular",
    "contours",
    "fit_ellipse",
    "label",
    "semi_axes",
    "smooth",
    "threshold",
]

OF_THE_MEAN = 0.7
"""The projections' threshold: bores are a third of the sheet, so half way from dark to bright is below the mean."""
SMALLEST_AREA_PX = 30
LARGEST_SHARE = 0.5
"""Of the picture's width or height that one tube may take."""
LEAST_FILL = 0.55
"""Of its bounding box that a region fills; a disc fills pi/4."""
LARGEST_ASPECT = 0.35
"""Difference of the axes over their mean; 0.35 is a circle seen at 45 deg."""
LARGEST_RAGGEDNESS = 0.08
"""RMS distance of the contour from its ellipse, over the mean semi-axis."""


class Threshold(enum.StrEnum):
    """What step 2 takes its threshold from."""

    HISTOGRAM = "histogram"
    PROFILE = "profile"
    PROJECTION = "projection"


@dataclass(frozen=True, slots=True, eq=False)
class Contour:
    """One dark region and its outline.

    Attributes
    ----------
    points_px
        (n, 2) float64, (x, y): the region's own pixels that touch its outside.
    region
        (h, w) bool, the region without holes.
    corner_px
        (x, y) of `region[0, 0]`.
    """

    points_px: NDArray[np.float64]
    region: Mask
    corner_px: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Ellipse:
    """A fitted ellipse. `semi_axes_px` belong to its own x and y axis, the first turned by `angle_deg` in the picture.

    `residual_px` is the RMS distance of the fitted points from it.
    """

    center_px: tuple[float, float]
    semi_axes_px: tuple[float, float]
    angle_deg: float
    residual_px: float


def smooth(picture: Picture, sigma_px: float = 1.0) -> Grey:
    """Step 1: smooth. A 3x3 median takes out single specks, a Gaussian of `sigma_px` the noise; float32."""
    grey = cv2.medianBlur(np.ascontiguousarray(picture, dtype=np.float32), 3)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma_px), dtype=np.float32)


def threshold(grey: Grey, method: Threshold) -> Grey:
    """Step 2: the threshold by histogram, profile or projection, one value a pixel, (h, w) or broadcasting to it."""
    return {
        Threshold.HISTOGRAM: _histogram_threshold,
        Threshold.PROFILE: _profile_threshold,
        Threshold.PROJECTION: _projection_threshold,
    }[method](grey)


def _histogram_threshold(grey: Grey) -> Grey:
    """Split the intensity histogram in two classes of least variance (Otsu), one value for the whole picture."""
    counts, edges = np.histogram(grey, bins=256)
    middles = (edges[:-1] + edges[1:]) / 2
    below = np.cumsum(counts)
    sum_below = np.cumsum(counts * middles)
    above, sum_above = below[-1] - below, sum_below[-1] - sum_below
    both = (below > 0) & (above > 0)
    between = np.zeros(len(counts))
    between[both] = below[both] * above[both] * (sum_below[both] / below[both] - sum_above[both] / above[both]) ** 2.0
    best = np.flatnonzero(between >= between.max())  # an empty valley is a plateau: its middle
    return np.full((1, 1), edges[1 + round(float(best.mean()))], np.float32)


def _profile_threshold(grey: Grey) -> Grey:
    """Half way between dark and bright along the horizontal profiles of most contrast, one value for the picture."""
    dark, bright = np.percentile(grey, (10, 90), axis=1)
    contrast = bright - dark
    lit = contrast >= np.percentile(contrast, 75)
    return np.full((1, 1), np.median((dark + bright)[lit]) / 2, np.float32)


def _projection_threshold(grey: Grey) -> Grey:
    """A share of mean grey along rows times mean along columns: follows light that falls off along either."""
    mean = float(grey.mean())
    if not mean > 0:
        return np.full((1, 1), mean, np.float32)
    h, w = grey.shape
    rows = cv2.blur(grey.mean(axis=1, keepdims=True), (1, max(3, h // 4)), borderType=cv2.BORDER_REFLECT)
    columns = cv2.blur(grey.mean(axis=0, keepdims=True), (max(3, w // 4), 1), borderType=cv2.BORDER_REFLECT)
    return np.asarray(rows.reshape(h, 1) * columns.reshape(1, w) * (OF_THE_MEAN / mean), dtype=np.float32)


def binarize(grey: Grey, level: Grey) -> Mask:
    """Step 2: the binary picture, True where it is darker than the threshold: the bores."""
    return np.asarray(grey < level)


def label(dark: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Step 3: connectivity analysis. Labels, (h, w), 0 the background; and (n, 5) x, y, width, height, area of each.

    Row i of the table belongs to label i; row 0 is the background's.
    """
    _, labels, table, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=4)
    return np.asarray(labels, dtype=np.int32), np.asarray(table, dtype=np.int32)


def contours(labels: NDArray[np.int32], table: NDArray[np.int32]) -> list[Contour]:
    """Step 4: the contour of each label by the gradient of its mask.

    Regions cut by the picture's border, too small, too large or too sparse for a tube are left out.
    """
    h, w = labels.shape
    x, y, width, height, area = table.T
    whole = (x > 0) & (y > 0) & (x + width < w) & (y + height < h)
    size = (area >= SMALLEST_AREA_PX) & (width < LARGEST_SHARE * w) & (height < LARGEST_SHARE * h)
    candidates = np.flatnonzero(whole & size & (area >= LEAST_FILL * width * height))
    return [_contour(labels, table, i) for i in candidates.tolist() if i != 0]


def _contour(labels: NDArray[np.int32], table: NDArray[np.int32], number: int) -> Contour:
    x, y, width, height, _ = table[number].tolist()
    region = ndimage.binary_fill_holes(labels[y : y + height, x : x + width] == number)
    inner = cv2.erode(
        np.pad(region, 1).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    )[1:-1, 1:-1]  # fmt: skip
    rows, columns = np.nonzero(region & (inner == 0))
    return Contour(np.stack([columns + x, rows + y], axis=1).astype(np.float64), region, (x, y))


def circular(found: Sequence[Contour]) -> list[Contour]:
    """Step 5: keep the contours whose aspect is small for their size and that follow their ellipse."""
    return [c for c in found if (e := fit_ellipse(c.points_px)) is not None and _round(e)]


def _round(ellipse: Ellipse) -> bool:
    mean = sum(ellipse.semi_axes_px) / 2
    return aspect_px(ellipse) <= LARGEST_ASPECT * 2 * mean and ellipse.residual_px <= LARGEST_RAGGEDNESS * mean + 0.3


def aspect_px(ellipse: Ellipse) -> float:
    """Step 5's aspect: the difference of major and minor axis, px; 0 for a circle."""
    a, b = ellipse.semi_axes_px
    return 2 * abs(a - b)


def fit_ellipse(points_px: NDArray[np.float64]) -> Ellipse | None:
    """Fit an ellipse by least squares of equation 9, ``1 - conic``; None where the points lie on no ellipse.

    Equations 8 to 11 as printed find a and b about a known centre and along known axes. Centre and direction come
    from the same criterion with the general conic ``A x^2 + B xy + C y^2 + D x + E y`` about the points' mean; a and
    b then from equation 11.
    """
    if len(points_px) < 6:
        return None
    mean = points_px.mean(axis=0)
    scale = float(np.sqrt(((points_px - mean) ** 2).mean()))
    placed = _center_and_angle((points_px - mean) / scale) if scale > 0 else None
    if placed is None:
        return None
    center, angle = mean + scale * placed[0], placed[1]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    own = (points_px - center) @ turn
    axes = semi_axes(own)
    if axes is None:
        return None
    beyond = 1 - 1 / np.maximum(np.hypot(*(own / axes).T), 1e-9)
    residual = float(np.sqrt(((own * beyond[:, None]) ** 2).sum(axis=1).mean()))
    return Ellipse((float(center[0]), float(center[1])), axes, float(np.degrees(angle)), residual)


def _center_and_angle(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float] | None:
    """Centre, (2,), and direction of one axis, rad, of the conic through points of unit spread; None for no ellipse."""
    x, y = points.T
    terms = np.stack([x * x, x * y, y * y, x, y], axis=1)
    (a, b, c, d, e), _, rank, _ = np.linalg.lstsq(terms, np.ones(len(x)), rcond=1e-9)
    if rank < 5 or not 4 * a * c - b * b > 1e-9 * (a + c) ** 2:
        return None
    center = np.linalg.solve(np.array([[2 * a, b], [b, 2 * c]]), -np.array([d, e]))
    return center, float(0.5 * np.arctan2(b, a - c))


def semi_axes(points: NDArray[np.float64]) -> tuple[float, float] | None:
    """Solve equation 11 for the semi-axes (a, b) of (n, 2) points about the centre, along the axes; None if it cannot.

    Divided by ``a^2 b^2`` its two equations are linear in 1/a^2 and 1/b^2.
    """
    q = points**2
    fourth = q.T @ q
    if np.linalg.det(fourth) <= 1e-12 * np.prod(np.diag(fourth)):
        return None
    a, b = np.linalg.solve(fourth, q.sum(axis=0)).tolist()
    return (a**-0.5, b**-0.5) if a > 0 and b > 0 else None
