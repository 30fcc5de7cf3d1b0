"""Rendered pictures of known truth, and by how much a measurement of them is off."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from drivers.optics import Optics
from drivers.rendering import Renderer, add_noise, quantised
from drivers.scene import ABSENT, CLEAN, GENERATORS, OPEN, PLUGGED, Look, Sheet, TubeLattice, make_sheet
from service.vision.camera import Camera, OpenCVLens, TsaiLens
from service.vision.lattice import Arrangement, Lattice
from service.vision.measurement import Doubt, Measurement, Origin, TubeState
from service.vision.process import Measurer
from service.vision.projection import undistort

PERIOD_NS = 40_000_000
ARRANGEMENTS = {a.value: TubeLattice(a.value, 25.0, 7.5, 9.0) for a in Arrangement}
PLAIN = replace(CLEAN, read_noise=0.0, shot_noise=0.0, texture=0.0, plugged=0.0, ambient=1.0, spot=math.inf)
"""Even light, no noise, all tubes open and in their places."""
STATES = {OPEN: TubeState.OPEN, PLUGGED: TubeState.PLUGGED, ABSENT: TubeState.ABSENT}


def optics_of(
    size_px=(320, 240), *, pitch_px=32.0, distance_mm=700.0, pitch_mm=25.4, bend=0.0, opencv=False, off_px=(3.0, -2.0)
) -> Optics:
    """A camera that shows `pitch_mm` at `distance_mm` as `pitch_px`; `bend`: distortion of the corner, barrel > 0."""
    (w, h), pixel_mm = size_px, 3.584 / size_px[0]
    focal_mm = pitch_px * distance_mm / pitch_mm * pixel_mm
    corner_mm = pixel_mm * math.hypot(w, h) / 2
    return Optics(
        w, h, focal_mm, (pixel_mm, pixel_mm), ((w - 1) / 2 + off_px[0], (h - 1) / 2 + off_px[1]),
        kappa1_per_mm2=0.0 if opencv else bend / corner_mm**2,
        opencv_distortion=(-bend * (focal_mm / corner_mm) ** 2, 0.0, 0.0, 0.0, 0.0) if opencv else None,
    )  # fmt: skip


def camera_of(optics: Optics, **changes) -> Camera:
    """The camera as its file would tell it, exact unless `changes` say otherwise."""
    lens = TsaiLens(optics.kappa1_per_mm2) if optics.opencv_distortion is None else OpenCVLens(optics.opencv_distortion)
    size = optics.width_px, optics.height_px
    camera = Camera(size, optics.pixel_pitch_mm, optics.focal_length_mm, lens, optics.principal_point_px)
    return replace(camera, **changes)


def unknown_camera(optics: Optics) -> Camera:
    """Nothing known but the size of picture and pixels."""
    return Camera((optics.width_px, optics.height_px), optics.pixel_pitch_mm, lens=None)


def lattice_of(tubes: TubeLattice, look: Look = CLEAN) -> Lattice:
    """What the engine is told of the tubes; their scatter is the picture's, a floor where there is none."""
    return Lattice(
        Arrangement(tubes.arrangement), tubes.pitch_mm, tubes.rim_radius_mm, tubes.outer_radius_mm,
        max(look.scatter_mm, 0.005), max(look.height_scatter_mm, 0.01),
    )  # fmt: skip


def looking(tilt_deg=0.0, azimuth_deg=40.0, roll_deg=10.0, distance_mm=700.0, at_mm=(0.0, 0.0)):
    """Pose (R, t) of a camera that looks at a point of the sheet, so far off along its axis."""
    a = math.radians(azimuth_deg)
    tilt = cv2.Rodrigues(np.array([math.cos(a), math.sin(a), 0.0]) * math.radians(tilt_deg))[0]
    rotation = cv2.Rodrigues(np.array([0.0, 0.0, math.radians(roll_deg)]))[0] @ tilt
    return rotation, np.array([0.0, 0.0, distance_mm]) - rotation[:, :2] @ np.asarray(at_mm)


@dataclass(frozen=True, eq=False)
class View:
    """A picture with its truth."""

    image: np.ndarray
    optics: Optics
    sheet: Sheet
    look: Look
    rotation: np.ndarray
    translation_mm: np.ndarray

    @property
    def lattice(self) -> Lattice:
        return lattice_of(self.sheet.lattice, self.look)

    @property
    def camera(self) -> Camera:
        return camera_of(self.optics)

    def measure(self, camera: Camera | None = None, lattice: Lattice | None = None, field="progressive") -> Measurement:
        return measurer_of(camera or self.camera, lattice or self.lattice).measure(self.image, 0, field)[0]


def measurer_of(camera: Camera, lattice: Lattice) -> Measurer:
    """A measurer whose clock stands still."""
    return Measurer(camera, lattice, lambda: 0)


def sheet_of(tubes: TubeLattice, look: Look = PLAIN, *, seed=0, reach=24) -> Sheet:
    """Tubes all round the sheet's origin."""
    return make_sheet(tubes, (-reach, -reach), (2 * reach + 1,) * 2, look, np.random.default_rng([seed, 1]))


def view(
    tubes: TubeLattice | str = "system80", look: Look = PLAIN, *, optics: Optics | None = None, pose=None, seed=0,
    sheet: Sheet | None = None, bits=8, **optics_settings,
) -> View:  # fmt: skip
    """Draw one picture."""
    tubes = GENERATORS[tubes] if isinstance(tubes, str) else tubes
    optics = optics or optics_of(pitch_mm=tubes.pitch_mm, **optics_settings)
    sheet = sheet or sheet_of(tubes, look, seed=seed)
    rotation, translation = pose or looking(6.0)
    image = Renderer(optics, sheet, look, np.random.default_rng([seed, 2])).draw(rotation, translation)
    noisy = add_noise(image, look, np.random.default_rng([seed, 3]))
    return View(quantised(noisy, bits), optics, sheet, look, rotation, translation)


@dataclass(frozen=True, eq=False)
class Errors:
    """How far a measurement is off; every array holds one row a tube, every pair (error, sigma).

    Attributes
    ----------
    measured_px, measured_sigma_px
        (m, 2) and (m,): against the actual tubes, those of them that are within a quarter pitch.
    inferred_px, inferred_sigma_px
        The same for predicted tubes, against the nominal lattice points.
    false
        Measured tubes where none is, or a plug.
    missed
        Open tubes wholly in the picture that are not told at all.
    index_share
        Share of the told tubes whose index one turn and shift of the lattice makes the true one.
    distance_mm, tilt_deg, lateral_mm
        (error, sigma); the lateral error has two components.
    states
        (n, 2): state told and true, of every place told.
    """

    measured_px: np.ndarray
    measured_sigma_px: np.ndarray
    inferred_px: np.ndarray
    inferred_sigma_px: np.ndarray
    false: int
    missed: int
    index_share: float
    distance_mm: tuple
    tilt_deg: tuple
    lateral_mm: tuple
    states: np.ndarray


def errors_of(seen: View, m: Measurement, *, odd_pose=None) -> Errors:
    """Compare a measurement with the truth of its picture."""
    rotation, translation = odd_pose or (seen.rotation, seen.translation_mm)
    sheet, optics = seen.sheet, seen.optics
    actual = sheet.centers_mm.reshape(-1, 3)
    nominal = np.insert(sheet.nominal_mm().reshape(-1, 2), 2, 0.0, axis=1)
    actual_px = np.nan_to_num(optics.project(rotation, translation, actual), nan=1e6)
    nominal_px = optics.project(rotation, translation, nominal)
    t = m.tubes
    off = np.linalg.norm(t.center_px[:, None] - actual_px[None], axis=2)
    nearest, reach = off.argmin(axis=1), np.partition(off, 1, axis=1)[:, 1]
    near = off[np.arange(len(t)), nearest] < 0.25 * np.median(reach)
    true = sheet.states.ravel()[nearest]
    measured = t.origin == Origin.MEASURED
    good, inferred = measured & near & (true == OPEN), ~measured & near
    w, h = optics.width_px, optics.height_px
    margin = 0.5 * np.median(reach)
    inside = ((actual_px > margin) & (actual_px < np.array([w, h]) - margin)).all(axis=1)
    told = np.zeros(len(actual), bool)
    told[nearest[near]] = True
    row, column = np.divmod(nearest, sheet.states.shape[1])
    return Errors(
        measured_px=t.center_px[good] - actual_px[nearest[good]],
        measured_sigma_px=t.sigma_px[good],
        inferred_px=t.center_px[inferred] - nominal_px[nearest[inferred]],
        inferred_sigma_px=t.sigma_px[inferred],
        false=int((measured & ~(near & (true == OPEN))).sum()),
        missed=int((inside & (sheet.states.ravel() == OPEN) & ~told).sum()),
        index_share=index_share(np.column_stack([t.row, t.column])[near], np.column_stack([row, column])[near]),
        states=np.column_stack([t.state[near], [STATES[int(s)] for s in true[near]]]),
        **_pose_errors(m, rotation, translation, actual[sheet.states.ravel() == OPEN]),
    )


def _pose_errors(m: Measurement, rotation, translation, tubes_mm) -> dict:
    pose = m.pose
    distance = float(rotation[:, 2] @ translation)
    tilt = math.degrees(math.acos(min(1.0, rotation[2, 2])))
    return {
        "distance_mm": (pose.distance_mm - distance, pose.sigma.distance_mm),
        "tilt_deg": (pose.tilt_deg - tilt, pose.sigma.tilt_deg),
        "lateral_mm": (_lateral_error(m, rotation, translation, tubes_mm), pose.sigma.lateral_mm),
    }


def _lateral_error(m: Measurement, rotation, translation, tubes_mm):
    """Error of the place, (2,) mm in camera axes, of the tube nearest the optical axis relative to that axis."""
    foot = np.array([0, 0, rotation[:, 2] @ translation / rotation[2, 2]])
    tubes = tubes_mm @ rotation.T + translation
    true = (tubes - foot)[np.linalg.norm((tubes - foot)[:, :2], axis=1).argmin()]
    pose, t = m.pose, m.tubes
    sheet = lattice_point(m)
    measured = t.origin == Origin.MEASURED
    told = sheet[measured] @ pose.rotation.T + pose.translation_mm
    told -= [0, 0, pose.distance_mm / pose.rotation[2, 2]]
    return (told[np.linalg.norm(told[:, :2] - true[:2], axis=1).argmin()] - true)[:2]


def lattice_point(m: Measurement):
    """Where the told centres lie on the told sheet, (n, 3) mm in the told sheet's frame."""
    ray = np.insert(undistort(m.pose.camera.vector(), m.tubes.center_px), 2, 1.0, axis=1)
    depth = m.pose.distance_mm / (ray @ m.pose.rotation[:, 2])
    return (ray * depth[:, None] - m.pose.translation_mm) @ m.pose.rotation


def index_share(told, true) -> float:
    """Share of (n, 2) integer pairs that one integer map and shift explains, the best of those that three pairs fix."""
    if len(told) < 6:
        return 0.0
    A = np.column_stack([told, np.ones(len(told))]).astype(float)
    best, *_ = np.linalg.lstsq(A, true.astype(float), rcond=None)
    for _ in range(4):
        turn = np.rint(best[:2])
        shift = np.rint(np.median(true - told @ turn, axis=0))
        fits = (told @ turn + shift == true).all(axis=1)
        if abs(round(np.linalg.det(turn))) != 1 or fits.sum() < 6:
            break
        best, *_ = np.linalg.lstsq(A[fits], true[fits].astype(float), rcond=None)
    return float(fits.mean()) if abs(round(np.linalg.det(turn))) == 1 else 0.0


def robust_sd(values) -> float:
    """1.4826 times the median absolute value: 1 for standard normal errors about 0."""
    return 1.4826 * float(np.median(np.abs(np.concatenate([np.ravel(v) for v in values]))))


def film(poses, tubes: TubeLattice | str = "system80", look: Look = PLAIN, *, optics: Optics | None = None, seed=0,
         sheet: Sheet | None = None, bits=8, **optics_settings) -> list[View]:  # fmt: skip
    """Draw a picture of each pose, all through the same camera."""
    tubes = GENERATORS[tubes] if isinstance(tubes, str) else tubes
    optics = optics or optics_of(pitch_mm=tubes.pitch_mm, **optics_settings)
    sheet = sheet or sheet_of(tubes, look, seed=seed)
    renderer = Renderer(optics, sheet, look, np.random.default_rng([seed, 2]))
    views = []
    for k, (rotation, translation) in enumerate(poses):
        noisy = add_noise(renderer.draw(rotation, translation), look, np.random.default_rng([seed, 3, k]))
        views.append(View(quantised(noisy, bits), optics, sheet, look, rotation, translation))
    return views


def woven(views: list[View], *, bottom_first=False) -> list[np.ndarray]:
    """Frames of two fields each, from pictures at twice the frame rate."""
    frames = []
    for first, second in zip(views[::2], views[1::2], strict=True):
        frame = first.image.copy()
        late = 0 if bottom_first else 1
        frame[late::2] = second.image[late::2]
        frames.append(frame)
    return frames


def follow(views: list[View], measurer: Measurer | None = None, *, times_ns=None) -> list[Measurement]:
    """Measure pictures one after the other."""
    measurer = measurer or measurer_of(views[0].camera, views[0].lattice)
    times_ns = times_ns or [k * PERIOD_NS for k in range(len(views))]
    return [
        measurer.measure(seen.image, time_ns, "progressive")[0] for seen, time_ns in zip(views, times_ns, strict=True)
    ]


def drift_pitches(views: list[View], answers: list[Measurement]) -> np.ndarray:
    """How far the told lattice has moved on the true one since the first answer, (n,) pitches; NaN without a pose.

    A fraction is error of measurement, a whole pitch is a slip of the index.
    """
    origin = np.full((len(views), 2), np.nan)
    for k, (seen, m) in enumerate(zip(views, answers, strict=True)):
        if m.pose is not None:
            origin[k] = (seen.rotation.T @ (m.pose.translation_mm - seen.translation_mm))[:2]
    return np.linalg.norm(origin - origin[0], axis=1) / views[0].sheet.lattice.pitch_mm


def in_doubt(answers: list[Measurement]) -> np.ndarray:
    """Whether each answer says that its index may have slipped, (n,)."""
    return np.array([Doubt.INDEX in m.doubt for m in answers])
