"""The paper's step 6: five ways to the centre of a contour."""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING

import numpy as np

from service.vision.segmentation import fit_ellipse

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from service.vision.segmentation import Contour

__all__ = ["CenterMethod", "box", "box1", "center", "center_sigma_px", "centroid", "circle", "ellipse"]


class CenterMethod(enum.StrEnum):
    """The five rows of the paper's Table 2."""

    BOX = "box"
    BOX1 = "box1"
    CENTROID = "centroid"
    CIRCLE = "circle"
    ELLIPSE = "ellipse"


def center(contour: Contour, method: CenterMethod) -> NDArray[np.float64]:
    """Centre of a contour, (2,) px, by one of the five methods; NaN where the method finds none."""
    return _METHODS[method](contour)


def box(contour: Contour) -> NDArray[np.float64]:
    """Middle of the bounding box, (2,) px: equation 5."""
    low, high = contour.points_px.min(axis=0), contour.points_px.max(axis=0)
    return np.asarray(low + (high - low) / 2)


def box1(contour: Contour) -> NDArray[np.float64]:
    """Middle of the four contact points, (2,) px: equation 6.

    x from the left end of the top row and the right end of the bottom row, y from the top end of the rightmost column
    and the bottom end of the leftmost.
    """
    x, y = contour.points_px.T
    left, right = x[y == y.min()].min(), x[y == y.max()].max()
    top, bottom = y[x == x.max()].min(), y[x == x.min()].max()
    return np.array([left + (right - left) / 2, top + (bottom - top) / 2])


def centroid(contour: Contour) -> NDArray[np.float64]:
    """Centre of area of the region, (2,) px: equation 7 with b = 1 inside."""
    rows, columns = np.nonzero(contour.region)
    return np.array([columns.mean() + contour.corner_px[0], rows.mean() + contour.corner_px[1]])


def circle(contour: Contour) -> NDArray[np.float64]:
    """Centre of the circle of least squares, (2,) px: ``x^2 + y^2 + D x + E y + F = 0``, linear in D, E, F."""
    mean = contour.points_px.mean(axis=0)
    p = contour.points_px - mean
    (d, e, _), _, rank, _ = np.linalg.lstsq(np.column_stack([p, np.ones(len(p))]), -(p**2).sum(axis=1), rcond=1e-9)
    return np.asarray(mean - np.array([d, e]) / 2) if rank == 3 else np.full(2, np.nan)


def ellipse(contour: Contour) -> NDArray[np.float64]:
    """Centre of the ellipse of least squares, (2,) px: equations 8 to 11, see `segmentation.fit_ellipse`."""
    fitted = fit_ellipse(contour.points_px)
    return np.full(2, np.nan) if fitted is None else np.array(fitted.center_px)


_METHODS: dict[CenterMethod, Callable[[Contour], NDArray[np.float64]]] = {
    CenterMethod.BOX: box,
    CenterMethod.BOX1: box1,
    CenterMethod.CENTROID: centroid,
    CenterMethod.CIRCLE: circle,
    CenterMethod.ELLIPSE: ellipse,
}


def center_sigma_px(contour: Contour, method: CenterMethod) -> float:
    """One sigma per axis of a centre, px, from how far the contour's points lie off their ellipse: s.

    Centroid, circle and ellipse rest on all n points: ``s sqrt(2/n)``. The box rests on two an axis: ``s / sqrt(2)``.
    So does box1, but on where a row of the outline ends, which runs along the edge: over a depth of s the end of the
    topmost row of a disc of radius r moves by about ``0.8 s sqrt(2 r)``. s is never below what the pixel grid alone
    leaves, 1/sqrt(12). The scatter of the tubes themselves is not in it.
    """
    fitted = fit_ellipse(contour.points_px)
    s = max(fitted.residual_px if fitted else 1.0, 1 / math.sqrt(12))
    if method is CenterMethod.BOX:
        return s / math.sqrt(2)
    if method is CenterMethod.BOX1:
        return 0.8 * s * math.sqrt(math.sqrt(contour.region.sum() / math.pi))
    return s * math.sqrt(2 / len(contour.points_px))
