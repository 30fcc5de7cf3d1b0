"""What the tubes' rims look like in the picture, for drawing."""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING

import numpy as np

from service.vision.measurement import Origin, TubeState
from service.vision.projection import project

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice
    from service.vision.measurement import Pose, Tubes

__all__ = ["TubeKind", "kinds", "rim_ellipses", "rim_outlines"]


class TubeKind(enum.IntEnum):
    """What a tube is drawn as."""

    MEASURED = 0
    PREDICTED = 1
    PLUGGED = 2
    ABSENT = 3


def kinds(tubes: Tubes) -> NDArray[np.int_]:
    """What each tube is drawn as, (n,) of `TubeKind`."""
    open_kind = np.where(tubes.origin == Origin.MEASURED, TubeKind.MEASURED, TubeKind.PREDICTED)
    special = [tubes.state == TubeState.PLUGGED, tubes.state == TubeState.ABSENT]
    return np.select(special, [TubeKind.PLUGGED, TubeKind.ABSENT], open_kind)


def rim_ellipses(pose: Pose, lattice: Lattice, tubes: Tubes, n: int = 8) -> NDArray[np.float64]:
    """The ellipses that come nearest to the rims' outlines.

    Returns
    -------
    (k, 6) float64, px: centre c and conjugate half-diameters u and v, the rim being ``c + u cos a + v sin a``. NaN
    where the lens model has no answer.
    """
    outlines = rim_outlines(pose, lattice, tubes, n)
    angles = np.arange(n) * (2 * math.pi / n)
    first_harmonic = np.stack([np.full(n, 0.5), np.cos(angles), np.sin(angles)]) * (2 / n)
    return np.asarray(np.einsum("hn,knx->khx", first_harmonic, outlines).reshape(len(tubes), 6))


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
