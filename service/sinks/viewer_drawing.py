"""What the viewer is shown of one frame: the picture with its tubes, the sheet and the camera, trends, state, events.

Entities::

    picture               the frame                   picture/tubes   rims and marks of its tubes, classed by kind
    sheet                 mm, Z into the tubes        sheet/tubes     the same tubes in space
    sheet/camera          sheet_from_camera, pinhole  sheet/view      what the picture shows of the sheet
    trend/distance, tilt  value, minus and plus one sigma             state/lock, events, status
    state/source          what the picture is worth                   health
"""

from __future__ import annotations

import math
import time
import uuid
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import cv2
import numpy as np

from service.sinks.pictures import ShownPictures
from service.sinks.quiet_rerun import rr
from service.sinks.viewer_marks import (
    LABELS,
    LOCK_COLORS,
    SOURCE_COLORS,
    class_ids,
    load_kernels,
    mark_widths,
    marks,
    strips_3d,
)
from service.sinks.viewer_status import status_text, why
from service.vision.measurement import Lock
from service.vision.outlines import kinds
from service.vision.projection import undistort

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.sinks.base import SourceState
    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement, Pose

__all__ = ["FRAME", "SIZE_PX", "TIME", "FrameDrawing", "Watch"]

FRAME, TIME = "frame", "time"
"""The two timelines: the number of the frame, and when it was exposed."""
JPEG_QUALITY = 85
SIZE_PX = (640, 480)
"""What is laid out for until a frame tells better."""
SHEET_PERIOD_NS = 90_000_000
CORNER = 0.5
"""Rerun's picture begins at the corner of its first pixel; ours, everywhere else, at that pixel's centre."""
TUBE_LENGTH_MM = 12.0
BORDER_POINTS = 6
"""Points a side of the picture's border on the sheet, which a lens bends."""


@dataclass(frozen=True, slots=True)
class Watch:
    """What is shown, the same to every viewer and file of it.

    Attributes
    ----------
    lattice
        The tubesheet.
    title
        Stands above the readings: what is being watched, live or replayed.
    epoch_ns
        Live: what makes UTC of the clock that frames are timed by. None: times count from a recording's start.
    recording_id
        Recordings of the same id are one to the viewer.
    """

    lattice: Lattice
    title: str = ""
    epoch_ns: int | None = None
    recording_id: str = field(default_factory=lambda: str(uuid.uuid4()))


class FrameDrawing:
    """Draws frames into one recording stream, each with its own results and nothing of another's.

    Parameters
    ----------
    watch
        What is shown.
    compress
        Send JPEG, for files: a third of the size. Viewers unpack it beside their drawing, so that a moving picture lags
        its overlay by a frame or more; live, pictures go as they are.
    monotonic_ns
        The clock of live frames.
    """

    def __init__(self, watch: Watch, *, compress: bool, monotonic_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._watch, self._compress, self._monotonic_ns = watch, compress, monotonic_ns
        self._said: tuple[Lock, str | None] | None = None
        self._generation, self._offset, self._last = -1, 0, -1
        self._stamp = ""
        self._shown = ShownPictures()
        self._source: tuple[str, str] | None = None
        self._size_px = SIZE_PX
        self._sheet_ns, self._sheet_empty = -SHEET_PERIOD_NS, True

    def prepare(self, stream: rr.RecordingStream) -> None:
        """Log what does not change: axes, names and colours."""
        load_kernels()
        stream.log("/", rr.AnnotationContext(LABELS), static=True)
        stream.log("sheet", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        view = rr.LineStrips3D.from_fields(colors=[(200, 200, 200)], radii=[-0.8])
        stream.log("sheet/view", view, static=True)
        greys = np.array([[230, 230, 230], [140, 140, 140], [140, 140, 140]], np.uint8)
        for name, unit in (("distance", "mm"), ("tilt", "deg")):
            names = [f"{name}, {unit}", "- 1 sigma", "+ 1 sigma"]
            stream.log(f"trend/{name}", rr.SeriesLines(names=names, colors=greys, widths=[2.0, 1.0, 1.0]), static=True)
        locks = rr.StateConfiguration(
            values=[str(lock) for lock in LOCK_COLORS],
            labels=[f"lock {lock}" for lock in LOCK_COLORS],
            colors=np.array(list(LOCK_COLORS.values()), np.uint8),
        )
        stream.log("state/lock", locks, static=True)
        words = [*SOURCE_COLORS]
        sources = rr.StateConfiguration(
            values=words, labels=words, colors=np.array([SOURCE_COLORS[w] for w in words], np.uint8)
        )
        stream.log("state/source", sources, static=True)

    def draw(self, stream: rr.RecordingStream, frame: Frame, results: Sequence[FrameResult]) -> tuple[int, int]:
        """Log one frame: of interlaced video the first field, and the trends of both. Returns the picture's size."""
        for result in results[1:]:
            self._set_time(stream, result)
            _draw_trend(stream, result.measurement)
        result = results[0]
        self._set_time(stream, result)
        m = result.measurement
        size_px = self._draw_picture(stream, frame, m.field)
        order, classes = self._draw_marks(stream, m)
        if self._sheet_due(m):
            self._draw_sheet(stream, m, order, classes)
        _draw_trend(stream, m)
        self._size_px = size_px
        self._draw_state(stream, m)
        text = status_text(result, self._watch.title)
        stream.log("status", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        return size_px

    def event(self, stream: rr.RecordingStream, text: str, level: str) -> None:
        """Log a line of text: live, at the present time; of a recording, at that of the last frame."""
        self._set_present(stream)
        self._log_event(stream, text, level)

    def state(self, stream: rr.RecordingStream, state: SourceState) -> None:
        """Log what the picture is worth, and frame it while it is not what it claims to be."""
        self._set_present(stream)
        stream.log("health", rr.TextDocument(state.figures, media_type=rr.MediaType.MARKDOWN))
        if (state.word, state.reason) == self._source:
            return
        self._source = state.word, state.reason
        stream.log("state/source", rr.StateChange(state=state.word))
        if state.good:
            stream.log("picture/source", rr.Clear(recursive=True))
            return
        text = f"{state.word}: {state.reason}" if state.reason else state.word
        self._frame_picture(stream, "picture/source", text, SOURCE_COLORS[state.word], at=0.5)

    def _set_present(self, stream: rr.RecordingStream) -> None:
        if self._watch.epoch_ns is not None or self._last < 0:
            stream.set_time(FRAME, sequence=max(self._last, 0))
            self._set_clock(stream, 0 if self._watch.epoch_ns is None else self._monotonic_ns())

    def _frame_picture(
        self, stream: rr.RecordingStream, path: str, text: str, color: tuple[int, int, int, int], *, at: float
    ) -> None:
        """Draw a frame around the picture, and say why, at that share of its height."""
        w, h = self._size_px
        colors = np.array([color], np.uint8)
        stream.log(path, rr.Boxes2D(mins=[[0, 0]], sizes=[[w, h]], colors=colors, radii=[-2.0]))
        stream.log(f"{path}/why", rr.Points2D([[w / 2, at * h]], radii=[0.0], colors=colors, labels=[text]))

    def _log_event(self, stream: rr.RecordingStream, text: str, level: str) -> None:
        stream.log("events", rr.TextLog(f"{self._stamp}  {text}", level=level))

    def _set_time(self, stream: rr.RecordingStream, result: FrameResult) -> None:
        """Set both timelines; frame numbers go on where a reopened device begins again at 0."""
        if result.generation != self._generation:
            self._offset = self._last + 1 if self._generation >= 0 else 0
            self._generation = result.generation
        self._last = result.sequence + self._offset
        stream.set_time(FRAME, sequence=self._last)
        self._set_clock(stream, result.measurement.time_ns)

    def _set_clock(self, stream: rr.RecordingStream, time_ns: int) -> None:
        if self._watch.epoch_ns is None:
            stream.set_time(TIME, duration=np.timedelta64(time_ns, "ns"))
            self._stamp = f"{time_ns / 1e9:.2f} s"
        else:
            utc = np.datetime64(self._watch.epoch_ns + time_ns, "ns")
            stream.set_time(TIME, timestamp=utc)
            self._stamp = f"{str(utc)[11:22]} UTC"

    def _draw_picture(self, stream: rr.RecordingStream, frame: Frame, shown: str) -> tuple[int, int]:
        pixels = self._shown.picture(frame, shown)
        height, width = pixels.shape
        if self._compress:
            coded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
            stream.log("picture", rr.EncodedImage(contents=coded.tobytes(), media_type="image/jpeg"))
        else:
            stream.log(
                "picture",
                rr.Image(bytes=pixels.tobytes(), width=width, height=height, color_model="L", datatype="u8"),
            )
        return width, height

    def _draw_marks(self, stream: rr.RecordingStream, m: Measurement) -> tuple[NDArray[np.intp], NDArray[np.uint16]]:
        """Mark the tubes in the picture; returns in which order, and their classes in that order."""
        lattice, tubes = self._watch.lattice, m.tubes
        kind = kinds(tubes)
        order = np.argsort(kind, kind="stable")
        strips = marks(m.pose, lattice, tubes, kind, CORNER)
        kind = kind[order]
        ids = class_ids(kind, doubtful=m.lock is not Lock.FULL)
        stream.log("picture/tubes", rr.LineStrips2D(strips, class_ids=ids, radii=-mark_widths(kind) / 2))
        return order, ids

    def _sheet_due(self, m: Measurement) -> bool:
        """Whether to draw the sheet again: ten times a second will do for what nobody judges; at once if it goes."""
        due = not 0 <= m.time_ns - self._sheet_ns < SHEET_PERIOD_NS or (m.pose is None) != self._sheet_empty
        if due:
            self._sheet_ns, self._sheet_empty = m.time_ns, m.pose is None
        return due

    def _draw_sheet(
        self, stream: rr.RecordingStream, m: Measurement, order: NDArray[np.intp], classes: NDArray[np.uint16]
    ) -> None:
        lattice, tubes = self._watch.lattice, m.tubes
        places = lattice.sheet_points(tubes.row[order].astype(np.int_), tubes.column[order].astype(np.int_))
        cylinders = rr.Cylinders3D(
            centers=np.column_stack([places, np.full(len(places), TUBE_LENGTH_MM / 2)]),
            lengths=np.full(len(places), TUBE_LENGTH_MM, np.float32),
            radii=np.full(len(places), lattice.rim_radius_mm, np.float32),
            fill_mode=rr.components.FillMode.Solid,
            class_ids=classes,
        )
        stream.log("sheet/tubes", cylinders)
        _draw_camera(stream, m.pose)

    def _draw_state(self, stream: rr.RecordingStream, m: Measurement) -> None:
        """Log what the lock is where that changes, and frame the picture while it is not full."""
        reason = why(m)
        changed = (m.lock, reason) != self._said
        self._said = m.lock, reason
        text = f"lock {m.lock}" + (f": {reason}" if reason else "")
        if changed:
            stream.log("state/lock", rr.StateChange(state=str(m.lock)))
            self._log_event(stream, text, "INFO" if m.lock is Lock.FULL else "WARN")
        if m.lock is Lock.FULL:
            if changed:
                stream.log("picture/lock", rr.Clear(recursive=True))
            return
        self._frame_picture(stream, "picture/lock", text, LOCK_COLORS[m.lock], at=0.0)


def _draw_trend(stream: rr.RecordingStream, m: Measurement) -> None:
    p = m.pose
    for name, value, sigma in (
        ("distance", p.distance_mm if p else math.nan, p.sigma.distance_mm if p else math.nan),
        ("tilt", p.tilt_deg if p else math.nan, p.sigma.tilt_deg if p else math.nan),
    ):
        stream.log(f"trend/{name}", rr.Scalars(np.array([value, value - sigma, value + sigma])))  # NaN leaves a gap


def _draw_camera(stream: rr.RecordingStream, pose: Pose | None) -> None:
    if pose is None:
        stream.log("sheet/camera", rr.Clear(recursive=True))
        stream.log("sheet/view", rr.Clear(recursive=False))
        return
    v, sheet_from_camera = pose.camera.vector(), pose.rotation.T
    eye_mm = -sheet_from_camera @ pose.translation_mm
    pinhole = rr.Pinhole(
        focal_length=v[:2],
        principal_point=v[2:4] + CORNER,
        resolution=pose.camera.image_size_px,
        image_plane_distance=0.2 * pose.distance_mm,
    )
    stream.log("sheet/camera", rr.Transform3D(translation=eye_mm, mat3x3=sheet_from_camera))
    stream.log("sheet/camera/lens", pinhole)
    border = _border_on_sheet(pose, eye_mm)
    axis = np.array([eye_mm, [*pose.axis_foot_mm, 0.0]])
    strips = strips_3d(np.concatenate([border, axis]), [len(border), len(axis)])
    stream.log("sheet/view", rr.LineStrips3D(strips))


def _border_on_sheet(pose: Pose, eye_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """The picture's border laid on the sheet, (n, 3) mm, closed."""
    w, h = pose.camera.image_size_px
    s = np.arange(BORDER_POINTS) / BORDER_POINTS
    low, high = np.zeros_like(s), np.ones_like(s)
    x, y = np.concatenate([s, high, 1 - s, low, [0.0]]), np.concatenate([low, s, high, 1 - s, [0.0]])
    rays = undistort(pose.camera.vector(), np.stack([x * w, y * h], axis=1) - CORNER)
    rays = np.column_stack([rays, np.ones(len(rays))]) @ pose.rotation
    return np.asarray(eye_mm - rays * (eye_mm[2] / rays[:, 2:]))
