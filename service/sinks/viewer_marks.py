"""The marks that tell the tubes apart in the picture: by shape first, by colour as well."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]

from service.sinks.quiet_rerun import rr
from service.vision.camera import lens_vector
from service.vision.measurement import Lock
from service.vision.outlines import TubeKind, rim_outlines
from service.vision.projection import project, undistort

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from service.vision.lattice import Lattice
    from service.vision.measurement import Pose, Tubes

__all__ = ["LABELS", "LOCK_COLORS", "SOURCE_COLORS", "class_ids", "load_kernels", "mark_widths", "marks", "strips_3d"]

NAMES = ("measured", "predicted", "plugged", "absent")
# Okabe and Ito's palette, which the colour-blind tell apart. What is normal stays pale.
COLORS = ((120, 195, 240), (230, 159, 0), (225, 130, 185), (170, 170, 170))
WIDTHS = np.array([1.2, 1.2, 1.8, 3.0], np.float32)
LOCK_COLORS = {
    Lock.FULL: (128, 138, 148, 255),
    Lock.PARTIAL: (230, 159, 0, 255),
    Lock.NONE: (213, 94, 0, 255),
}
SOURCE_COLORS = {
    **dict.fromkeys(("LIVE", "REPLAY", "SIMULATED", "STARTING", "ENDED"), (128, 138, 148, 255)),
    **dict.fromkeys(("RECONNECTING",), (230, 159, 0, 255)),
    **dict.fromkeys(("NO SIGNAL", "FROZEN", "STALE"), (213, 94, 0, 255)),
}
DIMMED = 110
DOUBTFUL = 10
"""Added to the class of a tube while the lock is not full."""
LABELS = [
    rr.AnnotationInfo(id=kind + doubtful, label=NAMES[kind] + said, color=(*COLORS[kind], alpha))
    for doubtful, said, alpha in ((0, "", 255), (DOUBTFUL, ", in doubt", DIMMED))
    for kind in range(4)
]

RIM_POINTS = 16  # on the screen a rim has some ten points of radius: more corners would not be seen
RING = np.arange(RIM_POINTS + 1) % RIM_POINTS
# One stroke: round the rim from its lower right, across, on along the rim, and across again.
CROSSED_RING = np.array([*range(2, 18), 2, *range(10, 5, -1), 14]) % RIM_POINTS
CROSS = 0.5 * np.array([[-1, 0], [1, 0], [0, 0], [0, -1], [0, 1]], np.float32)
"""One stroke, in rim radii."""
DOT = 0.6 * np.array([[-1, 0], [1, 0]], np.float32)
"""A stroke as long as it is wide, px."""

STRIP_2D = rr.components.LineStrip2DBatch(np.zeros((1, 2, 2), np.float32)).as_arrow_array().type
STRIP_3D = rr.components.LineStrip3DBatch(np.zeros((1, 2, 3), np.float32)).as_arrow_array().type


def load_kernels() -> None:
    """Load the compiled functions that drawing takes: on the first frame it would cost the next dozen."""
    v = lens_vector(1.0, 1.0, (0.0, 0.0), None, 1.0)
    project(v, np.eye(3), np.zeros(3), np.zeros((0, 2)))
    undistort(v, np.zeros((0, 2)))


def class_ids(kind: NDArray[np.int_], *, doubtful: bool) -> NDArray[np.uint16]:
    """Rerun's classes of kinds, (n,), as `LABELS` explains them."""
    return (kind + DOUBTFUL * doubtful).astype(np.uint16)


def mark_widths(kind: NDArray[np.int_]) -> NDArray[np.float32]:
    """Line widths of kinds, (n,), in points of the screen."""
    return WIDTHS[kind]


def marks(pose: Pose | None, lattice: Lattice, tubes: Tubes, kind: NDArray[np.int_], corner: float) -> pa.Array:
    """Draw each tube as one stroke, px, first all of the first kind, and so on; `corner` is added to all points."""
    if pose is None:
        return _strips(np.zeros((0, 2)), [], STRIP_2D)
    outlines = rim_outlines(pose, lattice, tubes, RIM_POINTS).astype(np.float32)
    center = tubes.center_px.astype(np.float32)[:, None]
    predicted = kind == TubeKind.PREDICTED
    radius = np.ptp(outlines[predicted], axis=1)[:, None] / 2
    strokes = (
        outlines[kind == TubeKind.MEASURED][:, RING],
        center[predicted] + radius * CROSS,
        outlines[kind == TubeKind.PLUGGED][:, CROSSED_RING],
        center[kind == TubeKind.ABSENT] + DOT,
    )
    lengths = np.repeat([s.shape[1] for s in strokes], [len(s) for s in strokes])
    return _strips(np.concatenate([s.reshape(-1, 2) for s in strokes]) + corner, lengths, STRIP_2D)


def strips_3d(points: NDArray[np.float64], lengths: Sequence[int]) -> pa.Array:
    """Line strips of so many points each, out of one row of points, (n, 3)."""
    return _strips(points, lengths, STRIP_3D)


def _strips(points: NDArray[np.floating], lengths: Sequence[int] | NDArray[np.int_], kind: pa.DataType) -> pa.Array:
    """Strips in rerun's own form: what it makes of a list of arrays costs ten times as much."""
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    flat = pa.array(np.ascontiguousarray(points, np.float32).reshape(-1))
    return pa.ListArray.from_arrays(offsets, pa.FixedSizeListArray.from_arrays(flat, type=kind.value_type), type=kind)
