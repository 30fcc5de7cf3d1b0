"""Results to be shown, without measuring: made up, or taken from the truth of a rendered video."""

import json
import math
from pathlib import Path

import numpy as np

from drivers.frame import Field, Frame, PixelFormat
from service.results import FrameResult
from service.vision.camera import Camera, OpenCVLens, TsaiLens
from service.vision.lattice import Arrangement, Lattice
from service.vision.measurement import Lock, Measurement, Origin, Pose, PoseSigma, Tubes, TubeState
from service.vision.projection import project

LATTICE = Lattice(Arrangement.SQUARE, 24.892, 7.7216, 8.7376)
PERIOD_NS = 40_000_000
STATES = {"open": TubeState.OPEN, "plugged": TubeState.PLUGGED, "absent": TubeState.ABSENT}


def frame_of(pixels, sequence, generation=1, field=Field.PROGRESSIVE):
    kind = PixelFormat.MONO8 if pixels.dtype == np.uint8 else PixelFormat.MONO16
    time_ns = sequence * PERIOD_NS
    return Frame(pixels, sequence, time_ns, time_ns, field, kind, "drawn", generation)


def result_of(frame, lock, tubes, pose, *, reason=None, doubt=(), field="progressive", time_ns=None):
    time_ns = frame.timestamp_ns if time_ns is None else time_ns
    m = Measurement(field, lock, reason, doubt, tubes, pose, time_ns, {"total": 6.2})
    return FrameResult(frame.source, frame.sequence, frame.timestamp_ns, frame.generation, m)


def noise(size):
    """A picture that cannot be compressed, as a real one hardly can."""
    return np.random.default_rng(1).integers(0, 256, size[::-1], np.uint8)


def made_up(
    sequence=0,
    *,
    lock=Lock.FULL,
    reason=None,
    doubt=(),
    size=(160, 120),
    generation=1,
    field="progressive",
    pixels=None,
):
    """A frame, grey if nothing else, and its result: four measured tubes, two predicted, a plug and an absent one."""
    frame = frame_of(np.full(size[::-1], 90, np.uint8) if pixels is None else pixels, sequence, generation)
    if lock is Lock.NONE:
        return frame, result_of(frame, lock, Tubes.none(), None, reason=reason or "no tubes seen")
    camera = Camera(size, (0.0056, 0.0056), 2.0, TsaiLens(), ((size[0] - 1) / 2, (size[1] - 1) / 2))
    sigma = PoseSigma(0.3, 0.25, 0.08, 0.1, 0.0)
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 400.0 + sequence / 10]), camera, np.eye(6), sigma, 0.11)
    row, column = np.array([-1, -1, 0, 0, 0, 1, 1, 1], np.int32), np.array([-1, 1, -1, 0, 1, -1, 0, 1], np.int32)
    points = LATTICE.sheet_points(row, column)
    center = project(camera.vector(), pose.rotation, pose.translation_mm, points)
    origin = np.array([1, 1, 1, 1, 0, 0, 1, 0], np.uint8)
    state = np.array([1, 1, 1, 1, 1, 0, 2, 3], np.uint8)
    tubes = Tubes(row, column, center, np.full(8, 0.05), origin, state)
    return frame, result_of(frame, lock, tubes, pose, doubt=doubt, field=field)


def truth_results(path: Path):
    """Yield what a perfect service would say of each frame of a rendered video, given its ``.json``."""
    truth = json.loads(path.read_text())
    camera = _camera(truth["camera"])
    state = np.array([STATES[t["state"]] for t in truth["tubes"]], np.uint8)
    index = np.array([t["ab"] for t in truth["tubes"]], np.int32)
    for f in truth["frames"]:
        at, visible = np.array(f["tube_index"]), np.array(f["vis"])
        center = np.array(f["px"], float).reshape(-1, 2)
        inside = ((center >= 0) & (center <= np.array(camera.image_size_px) - 1)).all(axis=1)
        at, visible, center = at[inside], visible[inside], center[inside]
        origin = np.where(visible > 0.5, Origin.MEASURED, Origin.INFERRED).astype(np.uint8)
        tubes = Tubes(index[at, 1], index[at, 0], center, np.where(origin, 0.04, 0.12), origin, state[at])
        wobble = 0.1 * math.sin(f["i"] / 7)
        sigma = PoseSigma(0.4, 0.31 + wobble, 0.12 + wobble / 10, 0.2, 0.0)
        yield tubes, Pose(np.array(f["R"]), np.array(f["t"]), camera, np.eye(6), sigma, 0.14)


def _camera(c):
    d = c["distortion"]
    lens = TsaiLens(d["kappa1_per_mm2"]) if d["model"] == "tsai" else OpenCVLens(tuple(d["coeffs"]))
    return Camera((c["width"], c["height"]), tuple(c["pixel_mm"]), c["focal_mm"], lens, (c["K"][0][2], c["K"][1][2]))
