"""A simulated inspection as files: lossless video, and beside it its exact truth."""

from __future__ import annotations

import contextlib
import json
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
import numpy as np

from drivers.errors import ConfigError
from drivers.scene import ABSENT, OPEN, PLUGGED

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from av.video.stream import VideoStream

    from drivers.scene import Sheet
    from drivers.simulation import Scene

__all__ = ["render_video", "scene_truth"]

VIDEO_CODECS = {".mkv": ("matroska", "ffv1"), ".avi": ("avi", "ffv1"), ".nut": ("nut", "ffvhuff")}
STATE_NAMES = {OPEN: "open", PLUGGED: "plugged", ABSENT: "absent"}


def scene_truth(scene: Scene, frames: int, *, name: str, video: str) -> dict[str, Any]:
    """The truth file of a scene's first `frames` frames, as JSON's own types."""
    lattice = scene.sheet.lattice
    return {
        "name": name,
        "video": video,
        "fps": scene.rate_hz,
        "n_frames": frames,
        "interlaced": scene.interlaced,
        "first_field": "even rows (0,2,..) = R,t; odd rows = R_odd_field,t_odd_field" if scene.interlaced else None,
        "model": lattice.model,
        "model_label": lattice.label,
        "pattern": lattice.arrangement,
        "pitch_mm": lattice.pitch_mm,
        "tube_od_mm": 2 * lattice.outer_radius_mm,
        "wall_mm": lattice.outer_radius_mm - lattice.rim_radius_mm,
        "rim_radius_mm": lattice.rim_radius_mm,
        "plate_z_mm": 0.0,
        "camera": scene.optics.to_dict(),
        "pixel_convention": "integer coordinates at pixel centres; (0,0) = centre of the top-left pixel",
        "world": "Z=0 nominal tube-end rim plane, +Z into the tubes; Xc = R Xw + t",
        "px_layout": "px = flat [u0,v0,u1,v1,...] for tube_index; time = that of the (even field of the) frame",
        "tubes": _tubes(scene.sheet),
        "landmarks": [],
        "probe": None,
        "frames": [_frame(scene, number) for number in range(frames)],
    }


def _tubes(sheet: Sheet) -> list[dict[str, Any]]:
    nominal = sheet.nominal_mm()
    return [
        {
            "row": sheet.first[0] + i,
            "col": sheet.first[1] + j,
            "ab": [sheet.first[1] + j, sheet.first[0] + i],
            "xy": nominal[i, j].round(4).tolist(),
            "xyz_actual": sheet.centers_mm[i, j].round(4).tolist(),
            "state": STATE_NAMES[int(sheet.states[i, j])],
        }
        for i, j in np.ndindex(sheet.states.shape)
    ]


def _frame(scene: Scene, number: int) -> dict[str, Any]:
    rotation, translation = scene.pose(number)
    index, px, visible = scene.tubes_in_view(number)
    truth = {
        "i": number,
        "R": rotation.round(9).tolist(),
        "t": translation.round(5).tolist(),
        "tube_index": index.tolist(),
        "px": px.round(4).ravel().tolist(),
        "vis": visible.round(2).tolist(),
    }
    if scene.interlaced:
        rotation, translation = scene.pose(number, odd_field=True)
        truth |= {"R_odd_field": rotation.round(9).tolist(), "t_odd_field": translation.round(5).tolist()}
    return truth


def render_video(scene: Scene, path: Path, frames: int, *, progress: Callable[[int, int], None] | None = None) -> Path:
    """Write `frames` frames of a scene as lossless video, and beside it its truth as .json; gives the truth's path.

    Parameters
    ----------
    path
        .mkv or .avi (FFV1) or .nut (ffvhuff). Video and truth appear when both are complete.
    progress
        Called with the frames done and the frames in all.

    Raises
    ------
    ConfigError
        The path cannot be written, or its ending is none of these.
    """
    if path.suffix not in VIDEO_CODECS:
        raise ConfigError(f"{path}: unknown ending {path.suffix!r}; use {', '.join(VIDEO_CODECS)}")
    truth_path = path.with_suffix(".json")
    part, truth_part = (p.with_name(f".{p.name}.part") for p in (path, truth_path))
    try:
        _write_video(scene, part, *VIDEO_CODECS[path.suffix], frames, progress or (lambda _done, _total: None))
        truth_part.write_text(json.dumps(scene_truth(scene, frames, name=path.stem, video=path.name)))
        truth_part.replace(truth_path)
        part.replace(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; choose another place") from error
    finally:
        with contextlib.suppress(OSError):  # a folder that may not be looked into holds neither
            part.unlink(missing_ok=True)
            truth_part.unlink(missing_ok=True)
    return truth_path


def _write_video(
    scene: Scene, path: Path, container_format: str, codec: str, frames: int, progress: Callable[[int, int], None]
) -> None:
    rate = Fraction(scene.rate_hz).limit_denominator(1001)
    pixel_format = "gray" if scene.bits == 8 else "gray16le"
    with av.open(str(path), "w", format=container_format) as container:
        options = {"level": "3", "slicecrc": "1", "g": "1"} if codec == "ffv1" else {}
        stream: VideoStream = container.add_stream(codec, rate=rate, options=options)  # type: ignore[assignment]
        stream.width, stream.height, stream.pix_fmt = scene.optics.width_px, scene.optics.height_px, pixel_format
        for number in range(frames):
            frame = av.VideoFrame.from_ndarray(scene.picture(number), pixel_format)
            frame.pts, frame.time_base = number, 1 / rate
            container.mux(stream.encode(frame))
            progress(number + 1, frames)
        container.mux(stream.encode(None))
