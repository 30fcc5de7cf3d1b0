"""What the tubes' rims look like in the picture, for drawing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from service.vision.projection import project

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice
    from service.vision.measurement import Pose, Tubes

__all__ = ["rim_outlines"]


def rim_outlines(pose: Pose, lattice: Lattice, tubes: Tubes, n: int = 24) -> NDArray[np.float64]:
    """Project the tubes' rim circles, lens distortion in it.

    Each outline stands about its tube's own `center_px`: a measured tube is drawn where it was seen, not where the
    nominal lattice has it.

    Returns
    -------
    (k, n, 2) float64, (x, y) px of the full frame; `n` points once around each rim, the first not repeated. NaN
    where the lens model has no answer.
    """
    angles = np.arange(n) * (2 * math.pi / n)
    circle_mm = lattice.rim_radius_mm * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    centers_mm = lattice.sheet_points(tubes.row.astype(np.int_), tubes.column.astype(np.int_))
    sheet_mm = np.concatenate([centers_mm[:, None], centers_mm[:, None] + circle_mm], axis=1)
    points_px = project(pose.camera.vector(), pose.rotation, pose.translation_mm, sheet_mm.reshape(-1, 2))
    points_px = points_px.reshape(len(tubes), n + 1, 2)
    return np.asarray(points_px[:, 1:] + (tubes.center_px - points_px[:, 0])[:, None])
