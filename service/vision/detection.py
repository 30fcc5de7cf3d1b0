"""Find dark discs of about a known size: where tubes may be, before any pose is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["DISC_RADIUS_PX", "Blobs", "find_blobs"]

DISC_RADIUS_PX = 5.5
"""Radius that discs are shrunk to: large enough for the filter, small enough to be fast at any picture size."""
THRESHOLD = 0.12
"""Least response, in local standard deviations; a noise-free disc on its plate gives about 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Dark discs, strongest first.

    Attributes
    ----------
    center_px
        (n, 2) float64 in the picture's pixels.
    response
        (n,) float64 in local standard deviations.
    """

    center_px: NDArray[np.float64]
    response: NDArray[np.float64]


def find_blobs(
    image: NDArray[np.uint8] | NDArray[np.uint16], radius_px: tuple[float, float], limit: int = 1500
) -> Blobs:
    """Find dark discs by difference of Gaussians on the locally normalised picture.

    Local normalisation makes up for uneven light; a 3x3 median takes specks away.

    Parameters
    ----------
    image
        (h, w) grey.
    radius_px
        Expected (horizontal, vertical) radius: they differ in a single field.
    limit
        Most blobs to give.
    """
    h, w = image.shape
    size = max(16, round(w * DISC_RADIUS_PX / radius_px[0])), max(16, round(h * DISC_RADIUS_PX / radius_px[1]))
    smaller = size[0] <= w and size[1] <= h
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
    s = cv2.medianBlur(small, 3).astype(np.float32)
    box = (int(6.4 * DISC_RADIUS_PX) // 2 * 2 + 1,) * 2
    mean = cv2.blur(s, box)
    spread = np.sqrt(np.maximum(cv2.blur(s * s, box) - mean * mean, 0.0))
    floor = 2.0 if image.dtype == np.uint8 else 2.0 * 257
    z = np.clip((s - mean) / (spread + floor), -2.5, 2.5)
    sigma = 0.6 * DISC_RADIUS_PX
    response = cv2.GaussianBlur(z, (0, 0), 1.6 * sigma) - cv2.GaussianBlur(z, (0, 0), sigma)
    x, y, peak = _maxima(response, int(0.9 * DISC_RADIUS_PX))
    order = np.argsort(-peak, kind="stable")[:limit]
    center = np.column_stack([(x + 0.5) * (w / size[0]) - 0.5, (y + 0.5) * (h / size[1]) - 0.5])
    return Blobs(center[order], peak[order].astype(np.float64))


def _maxima(
    response: NDArray[np.float32], reach: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]:
    """Local maxima above THRESHOLD with a parabola's sub-pixel place."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    ys, xs = np.nonzero((response == cv2.dilate(response, disc)) & (response > THRESHOLD))
    inside = (xs > 0) & (ys > 0) & (xs < response.shape[1] - 1) & (ys < response.shape[0] - 1)
    ys, xs = ys[inside], xs[inside]
    c, left, right = response[ys, xs], response[ys, xs - 1], response[ys, xs + 1]
    up, down = response[ys - 1, xs], response[ys + 1, xs]
    dx = (right - left) / np.maximum(2 * (2 * c - left - right), 1e-6)
    dy = (down - up) / np.maximum(2 * (2 * c - up - down), 1e-6)
    return xs + np.clip(dx, -0.5, 0.5), ys + np.clip(dy, -0.5, 0.5), c
