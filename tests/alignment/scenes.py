"""Simulated truth: a camera before a sheet of real tubes, a guide on its arm, and what is measured and known of them.

Everything that a station knows is drawn about the truth with the sigma that it is said to have: focal length, pitch,
the guide's axis, tube ends, edges. So errors over sigmas must come out near one.
"""

from dataclasses import dataclass, replace

import numpy as np

from service.alignment.geometry import GuideAxis, StationGeometry, cross
from service.vision.camera import Camera, TsaiLens
from service.vision.lattice import Arrangement, Lattice
from service.vision.measurement import Lock, Measurement, Origin, Pose, PoseSigma, Tubes, TubeState
from service.vision.pose import fit_pose, linearise, prior_of
from service.vision.projection import project

SIZE = (640, 480)
LATTICE = Lattice(Arrangement.TRIANGULAR, 25.4, 8.458, 9.525, scatter_mm=0.05, height_scatter_mm=0.15)
CAMERA = Camera(SIZE, (0.005, 0.005), 10.0, TsaiLens(0.001), (322.0, 236.0))
GUIDE_SIGMA = np.array([2e-3, 2e-3, 2e-3, 0.05, 0.05, 0.05])
PROBE_MM, TUBE_MM = 15.748, 16.916


def turned(rotation_vector):
    angle = float(np.linalg.norm(rotation_vector))
    if angle == 0.0:
        return np.eye(3)
    k = cross(np.asarray(rotation_vector) / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


@dataclass
class Scene:
    """One truth with one measurement of it.

    `rotation`, `translation_mm` and `tubes_mm` (by lattice place) are true, in a world whose lattice has the true
    pitch; `guide` is the true axis, `geometry` what the station believes.
    """

    rotation: np.ndarray
    translation_mm: np.ndarray
    tubes_mm: dict
    pitch: float
    guide: GuideAxis
    geometry: StationGeometry
    measurement: Measurement

    def truth(self, place):
        """True (offset, slope, gap) of the guide's axis to a tube, in the sheet's axes."""
        R, t = self.rotation, self.translation_mm
        m, d = R.T @ (self.guide.point_mm - t), R.T @ self.guide.direction
        slope = d[:2] / d[2]
        return np.concatenate([m[:2] - slope * m[2] - self.tubes_mm[place][:2], slope, [-m[2]]])


def geometry_of(guide, **more):
    settings = {"gap_mm": None, "gap_sigma_mm": 0.0} | more
    return StationGeometry(guide, PROBE_MM, TUBE_MM, arm_normal=guide.direction, **settings)


def guide_over(rotation, translation_mm, foot_mm, slope=(0.0, 0.0), gap_mm=25.0, covariance=None):
    """The guide's axis in the camera frame that meets the sheet there."""
    d = np.array([*slope, 1.0])
    mouth = np.array([*foot_mm, 0.0]) - gap_mm * d
    covariance = np.zeros((6, 6)) if covariance is None else covariance
    return GuideAxis(rotation @ mouth + translation_mm, rotation @ (d / np.linalg.norm(d)), covariance, at_mouth=True)


def random_pose(rng, distance_mm=1000.0, tilt_deg=8.0):
    """A view along the sheet's normal but for a tilt in any direction; X within 30 deg of right; off the origin."""
    azimuth = rng.uniform(0, 2 * np.pi)
    tilt = np.radians(tilt_deg * rng.uniform(0.3, 1.0))
    R = turned([tilt * np.cos(azimuth), tilt * np.sin(azimuth), 0]) @ turned([0, 0, rng.uniform(-0.5, 0.5)])
    looked_at = rng.uniform(-300, 300, 2)
    return R, np.array([0, 0, distance_mm]) - R[:, :2] @ looked_at


def places_in_view(camera, lattice, R, t, margin_px=0.0):
    foot = (R.T @ -t)[:2] - R[2, :2] * (R.T @ -t)[2] / R[2, 2]
    row, column = np.rint(lattice.lattice_coordinates(foot[None])[0]).astype(int)
    rows, columns = (v.ravel() for v in np.mgrid[row - 30 : row + 31, column - 30 : column + 31])
    px = project(camera.vector(), R, t, lattice.sheet_points(rows, columns))
    w, h = SIZE
    inside = (px > margin_px).all(axis=1) & (px < np.array([w, h]) - 1 - margin_px).all(axis=1)
    return rows[inside], columns[inside]


def measure(rng, camera, lattice, R, t, places, tubes_mm, noise_px, known, time_ns=0, unseen=()):
    """A measurement as vision gives it: edges with noise, a robust pose, posterior centres.

    `camera` took the picture, `known` is what is known of it.
    """
    rows, columns = places
    n = len(rows)
    true = np.array([tubes_mm[p] for p in zip(rows.tolist(), columns.tolist(), strict=True)])
    seen_px = project(camera.vector(), R, t, true) + rng.normal(0, noise_px, (n, 2))
    nominal = lattice.sheet_points(rows, columns)
    cov = np.tile([noise_px**2, 0.0, noise_px**2], (n, 1))
    used = np.array([p not in unseen for p in zip(rows.tolist(), columns.tolist(), strict=True)])
    fit = fit_pose(nominal[used], seen_px[used], cov[used], known, R, t, lattice, prior_of(known))
    to_origin = np.eye(6)
    to_origin[3:, :3] = -cross(fit.translation_mm - fit.pivot_mm)
    about_origin = to_origin @ fit.covariance[:6, :6] @ to_origin.T
    px, J, place = np.empty((n, 2)), np.empty((n, 2, 6)), np.empty((n, 2, 3))
    linearise(
        fit.camera.vector(), 1.0, 1.0, fit.rotation, fit.translation_mm, fit.translation_mm, nominal, 6, px, J, place
    )
    S = place[:, :, :2] @ place[:, :, :2].transpose(0, 2, 1) * lattice.scatter_mm**2
    S = S + place[:, :, 2:] @ place[:, :, 2:].transpose(0, 2, 1) * lattice.height_scatter_mm**2
    gain = S @ np.linalg.inv(S + noise_px**2 * np.eye(2))
    center = np.where(used[:, None], px + np.einsum("nij,nj->ni", gain, seen_px - px), px)
    predicted = _predicted(fit, nominal)
    rest = np.eye(2) - gain
    variance = np.einsum("nii->n", gain) / 2 * noise_px**2
    variance += np.einsum("nij,njk,nik->n", rest, predicted, rest) / 2
    tubes = Tubes(
        rows.astype(np.int32),
        columns.astype(np.int32),
        center,
        np.sqrt(np.where(used, variance, np.einsum("nii->n", predicted) / 2)),
        np.where(used, Origin.MEASURED, Origin.INFERRED).astype(np.uint8),
        np.where(used, TubeState.OPEN, TubeState.UNKNOWN).astype(np.uint8),
    )
    f_sigma = np.sqrt(fit.covariance[6, 6]) if fit.names else 0.0
    pose = Pose(
        fit.rotation, fit.translation_mm, fit.camera, about_origin, PoseSigma(0.1, 0.1, 0.01, 0.02, float(f_sigma)), 0.1
    )
    return Measurement("progressive", Lock.FULL, None, (), tubes, pose, time_ns)


def _predicted(fit, nominal):
    """Covariance of projected places, (n, 2, 2) px^2, with that of an estimated focal length in it."""
    n, f = len(nominal), fit.camera.focal_length_mm
    px, J, place = np.empty((n, 2)), np.empty((n, 2, 16)), np.empty((n, 2, 3))
    linearise(fit.camera.vector(), f, 1.0, fit.rotation, fit.translation_mm, fit.pivot_mm, nominal, 16, px, J, place)
    J = J[:, :, : 6 + len(fit.names)]
    return np.einsum("nij,jk,nlk->nil", J, fit.covariance, J)


def scattered(rng, lattice, places, pitch=1.0):
    """True tube ends by place, (3,) mm each."""
    rows, columns = places
    nominal = lattice.sheet_points(rows, columns) * pitch
    n = len(rows)
    away = np.column_stack([rng.normal(0, lattice.scatter_mm, (n, 2)), rng.normal(0, lattice.height_scatter_mm, n)])
    ends = np.column_stack([nominal, np.zeros(n)]) + away
    return dict(zip(zip(rows.tolist(), columns.tolist(), strict=True), ends, strict=True))


def make_scene(
    seed, *, noise_px=0.05, focal_sigma_mm=0.0, pitch_sigma_mm=0.0, guide_sigma=GUIDE_SIGMA, tilt_deg=8.0, unseen=False
):
    """A scene with its target: the tube nearest the picture's middle, the guide's axis within 1 mm and 1 deg of it."""
    rng = np.random.default_rng(seed)
    R, t = random_pose(rng, tilt_deg=tilt_deg)
    lattice = replace(LATTICE, pitch_sigma_mm=pitch_sigma_mm)
    pitch = 1.0 + rng.normal(0, pitch_sigma_mm / lattice.pitch_mm)
    t = t * pitch
    known = CAMERA
    if focal_sigma_mm:
        known = replace(
            CAMERA,
            focal_length_mm=CAMERA.focal_length_mm + rng.normal(0, focal_sigma_mm),
            parameters=("focal_length_mm",),
            covariance=np.array([[focal_sigma_mm**2]]),
        )
    true_lattice = replace(lattice, pitch_mm=lattice.pitch_mm * pitch)
    places = places_in_view(CAMERA, true_lattice, R, t)
    tubes_mm = scattered(rng, lattice, places, pitch)
    i = rng.integers(len(places[0]))
    target = int(places[0][i]), int(places[1][i])
    covariance = np.diag(guide_sigma**2)
    foot = tubes_mm[target][:2] + rng.uniform(-1, 1, 2)
    guide = guide_over(R, t, foot, np.tan(np.radians(rng.uniform(-1, 1, 2))), rng.uniform(15, 40), covariance)
    error = rng.normal(0, guide_sigma)
    believed = GuideAxis(guide.point_mm + error[3:], turned(error[:3]) @ guide.direction, covariance, at_mouth=True)
    measurement = measure(
        rng, CAMERA, lattice, R, t, places, tubes_mm, noise_px, known, unseen=(target,) if unseen else ()
    )
    return Scene(R, t, tubes_mm, pitch, guide, geometry_of(believed), measurement), target, lattice


def robust_sd(values):
    """1.4826 times the median of what is around zero: an error's spread, bias and all."""
    return 1.4826 * float(np.median(np.abs(values)))
