"""Results as vision would give them, made up."""

import numpy as np

from service.results import FrameResult
from service.vision.camera import Camera, TsaiLens
from service.vision.measurement import Doubt, Lock, Measurement, Origin, Pose, PoseSigma, Tubes, TubeState

CAMERA = Camera((640, 480), (0.005, 0.005), 10.0, TsaiLens(0.001), (320.0, 240.0))


def make_pose(tilt_deg=5.0, distance_mm=1000.0):
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    rotation = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
    translation = rotation[:, 2] * distance_mm
    return Pose(rotation, translation, CAMERA, np.eye(6), PoseSigma(0.3, 0.2, 0.05, 0.02, 0.0), 0.08)


def make_measurement(lock=Lock.FULL, *, field="progressive", measured=3, inferred=2, doubt=(), reason=None, **pose):
    if lock is Lock.NONE:
        return Measurement(field, lock, reason or "nothing there", (), Tubes.none(), None, 0, {"total": 1.5})
    n = measured + inferred
    tubes = Tubes(
        np.arange(n, dtype=np.int32),
        np.zeros(n, np.int32),
        np.stack([np.linspace(100, 500, n), np.full(n, 240.0)], axis=1),
        np.full(n, 0.05),
        np.array([Origin.MEASURED] * measured + [Origin.INFERRED] * inferred, np.uint8),
        np.array([TubeState.OPEN] * measured + [TubeState.UNKNOWN] * inferred, np.uint8),
    )
    doubt = (Doubt.INDEX,) if lock is Lock.PARTIAL and not doubt else doubt
    return Measurement(field, lock, None, doubt, tubes, make_pose(**pose), 0, {"total": 12.34})


def make_result(lock=Lock.FULL, *, source="bowl.mp4", sequence=0, **measurement):
    return FrameResult(source, sequence, sequence * 40_000_000, 1, make_measurement(lock, **measurement))
