"""Centres as a camera would measure them while a robot is hung in: exact physics, point noise, scattered tubes."""

import numpy as np
from scipy.spatial.transform import Rotation

from service.vision.camera import Camera, TsaiLens
from service.vision.keyframes import Keyframe
from service.vision.lattice import Arrangement, Lattice
from service.vision.projection import project
from service.vision.sites import sites_in_picture

TRUE = Camera((640, 480), (0.005, 0.005), 6.5, TsaiLens(-0.004), (322.0, 236.0), 1.001)
UNKNOWN = Camera((640, 480), (0.005, 0.005), sx=None)
LATTICE = Lattice(Arrangement.TRIANGULAR, 25.4, 8.46, 9.5, 0.06, 0.15)


def seen_from(tilt_x_deg, tilt_y_deg, distance_mm=1066.0, at_mm=(3.0, 5.0), roll_deg=0.0):
    """Pose whose optical axis meets the sheet at a point, at a distance along the axis."""
    rotation = Rotation.from_euler("yxz", [tilt_y_deg, tilt_x_deg, roll_deg], degrees=True).as_matrix()
    return rotation, np.array([0.0, 0.0, distance_mm]) - rotation[:, :2] @ np.array(at_mm)


def tilted(rng, count, most_deg=15.0):
    """Poses of tilts all round, up to `most_deg`."""
    size, angle = most_deg * np.sqrt((np.arange(count) + 0.5) / count), 2.4 * np.arange(count)
    return [
        seen_from(s * np.cos(a), s * np.sin(a), 1066 * (1 + 0.05 * rng.standard_normal()), rng.uniform(-60, 60, 2))
        for s, a in zip(size, angle, strict=True)
    ]


class Sheet:
    """Tubes, each with an offset of its own that stays the same in every picture.

    So does a smooth field over the picture, of what light and lens do beyond the model: `bend_px` its coefficients.
    """

    def __init__(self, rng, scatter_mm=0.06, height_mm=0.0, lattice=LATTICE, bend_px=0.0):
        self.field_px, self.bulge_px = bend_px * rng.standard_normal((6, 2)), bend_px * rng.standard_normal()
        self.rng, self.lattice, self.scatter_mm = rng, lattice, (scatter_mm, scatter_mm, height_mm)
        self.offset_mm = {}

    def picture(self, pose, camera=TRUE, noise_px=0.05, seen=0.7, series=0):
        """Give what one picture says; its own idea of the focal length is 5 % off, and so is its distance."""
        rotation, translation = pose
        sites = sites_in_picture(camera.vector(), rotation, translation, self.lattice, camera.image_size_px, -8.0)
        sites = sites.take(self.rng.random(len(sites)) < seen)
        key = zip(sites.row.tolist(), sites.column.tolist(), strict=True)
        off = np.array([self.offset_mm.setdefault(k, self.rng.standard_normal(3) * self.scatter_mm) for k in key])
        px = project(
            camera.vector(), rotation, translation, np.column_stack([sites.sheet_mm, np.zeros(len(sites))]) + off
        )
        at = 2 * px / np.array(camera.image_size_px) - 1
        x, y = at.T
        px = px + np.stack([0 * x, x, y, x * x, x * y, y * y], axis=1) @ self.field_px
        px = px + self.bulge_px * at * np.sum(at**2, axis=1, keepdims=True)
        wrong = np.exp(0.05 * self.rng.standard_normal())
        f = camera.focal_length_mm * wrong
        return Keyframe(
            series=series,
            row=sites.row,
            column=sites.column,
            sheet_mm=sites.sheet_mm,
            center_px=px + noise_px * self.rng.standard_normal(px.shape),
            covariance_px=np.tile([noise_px**2, 0.0, noise_px**2], (len(sites), 1)),
            light_px=np.zeros((len(sites), 2)),
            shift_variance_px2=np.full(2, 0.01**2),
            light_variance=0.3**2,
            camera=Camera(camera.image_size_px, camera.pixel_pitch_mm, f, TsaiLens(0.0), camera.middle_px),
            focal_sigma_mm=0.05 * f,
            rotation=rotation,
            translation_mm=translation * [1.0, 1.0, wrong],
            pitch_mm=self.lattice.pitch_mm,
        )


def installation(seed=0, count=12, most_deg=15.0, **sheet):
    """Pictures of a sheet while the camera tilts about."""
    rng = np.random.default_rng(seed)
    there = Sheet(rng, **sheet)
    return [there.picture(pose) for pose in tilted(rng, count, most_deg)]
