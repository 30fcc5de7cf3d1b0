"""A simulated inspection: a camera's way along a tubesheet, and its pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from drivers.optics import Optics
from drivers.rendering import Renderer, add_noise, quantised
from drivers.scene import ABSENT, NOMINAL, make_sheet

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from drivers.frame import Pixels
    from drivers.scene import Look, Sheet, TubeLattice

    Pose: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
    Trajectory: TypeAlias = Callable[[float], Pose]

__all__ = ["Scene", "default_scene", "there_and_back"]

RIM_POINTS, HALF_COVERED = 24, 128
MOST_SITES = 400  # a side of the sheet's rectangle, however the camera looks
SENSOR_WIDTH_MM = 640 * 0.0056
FASTEST = 0.15  # pitches a frame


class Scene:
    """Frames of a sheet seen along a trajectory.

    Parameters
    ----------
    optics, sheet, look
        Camera, tubes and light.
    trajectory
        Time, s, to (R, t_mm) with Xc = R Xw + t.
    rate_hz
        Frames a second.
    interlaced
        Even rows are exposed at a frame's time, odd rows half a frame later.
    bits
        8 or 16.
    rng
        For texture and noise. A frame's noise depends on its number only, not on the order of drawing.
    """

    def __init__(
        self, optics: Optics, sheet: Sheet, look: Look, trajectory: Trajectory, *, rate_hz: float,
        interlaced: bool = False, bits: int = 8, rng: np.random.Generator,
    ) -> None:  # fmt: skip
        if bits not in (8, 16):
            raise ValueError(f"bits = {bits}: must be 8 or 16")
        self.optics, self.sheet, self.look, self.rate_hz = optics, sheet, look, rate_hz
        self.interlaced, self.bits = interlaced, bits
        self._trajectory = trajectory
        self._renderer = Renderer(optics, sheet, look, rng)
        self._noise_seed = int(rng.integers(1 << 62))

    def pose(self, number: int, *, odd_field: bool = False) -> Pose:
        """Pose at a frame's time, or at that of its odd rows."""
        return self._trajectory((number + 0.5 * odd_field) / self.rate_hz)

    def picture(self, number: int) -> Pixels:
        """Draw frame `number`."""
        image = self._renderer.draw(*self.pose(number))
        if self.interlaced:
            image[1::2] = self._renderer.draw(*self.pose(number, odd_field=True))[1::2]
        rng = np.random.default_rng([self._noise_seed, number])
        return quantised(add_noise(image, self.look, rng), self.bits)

    def tubes_in_view(self, number: int) -> tuple[NDArray[np.int_], NDArray[np.float64], NDArray[np.float64]]:
        """Tubes whose rim touches frame `number` (its even rows where it is interlaced).

        Their index in the sheet's raster, (n,); their rims' centres in the picture, (n, 2) px; the share of each rim
        that is inside the picture and not covered, (n,).
        """
        rotation, translation = self.pose(number)
        optics, angles = self.optics, np.linspace(0, math.tau, RIM_POINTS, endpoint=False)
        centers = self.sheet.centers_mm.reshape(-1, 3)
        circle = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1) * self.sheet.lattice.rim_radius_mm
        rims = optics.project(rotation, translation, centers[:, None] + circle)
        size = (optics.width_px, optics.height_px)
        inside = np.all((rims > -0.5) & (rims < np.subtract(size, 0.5)), axis=-1)  # NaN is not inside
        index = np.flatnonzero(inside.any(axis=1) & (self.sheet.states.ravel() != ABSENT))
        at = np.where(inside[..., None], rims, 0)[index].round().astype(int)
        free = self._renderer.hose_cover(rotation, translation)[at[..., 1], at[..., 0]] < HALF_COVERED
        visible = (inside[index] & free).mean(axis=1)
        return index, optics.project(rotation, translation, centers[index]), visible


@dataclass(frozen=True, slots=True)
class _Sway:
    """There and back along a smooth way, at rest at both ends, without end."""

    base: NDArray[np.float64]
    camera_mm: NDArray[np.float64]
    pan_tilt_roll: tuple[float, float, float]
    drift_mm: NDArray[np.float64]
    duration_s: float

    def __call__(self, time_s: float) -> Pose:
        way = (1 - math.cos(math.pi * time_s / self.duration_s)) / 2
        pan, tilt, roll = self.pan_tilt_roll
        turn = (
            _rotation(2, roll * way) @ _rotation(0, tilt * math.sin(math.tau * way)) @ _rotation(1, pan * (way - 0.5))
        )
        rotation = turn @ self.base
        return rotation, -rotation @ (self.camera_mm + way * self.drift_mm)


def _rotation(axis: int, angle: float) -> NDArray[np.float64]:
    c, s = math.cos(angle), math.sin(angle)
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def there_and_back(
    optics: Optics, lattice: TubeLattice, *, distance_mm: float, duration_s: float, rate_hz: float,
    rng: np.random.Generator,
) -> Trajectory:  # fmt: skip
    """Draw a way of panning, tilting and a little rolling and drifting, at most 0.15 pitches a frame fast.

    The sheet is `distance_mm` off along the axis, tilted 2 to 15 deg; after `duration_s` the camera goes back.
    """
    turn = _rotation(2, rng.uniform(-math.pi, math.pi))
    tilt = math.radians(rng.uniform(2, 15))
    base = _rotation(2, math.radians(rng.uniform(-20, 20))) @ turn.T @ _rotation(0, tilt) @ turn
    target = np.append(rng.uniform(-20, 20, 2) * lattice.pitch_mm, 0.0)
    focal_px = float(optics.matrix[0, 0])
    frames = duration_s * rate_hz
    fastest = FASTEST * focal_px * lattice.pitch_mm / distance_mm * frames * 2 / math.pi  # px over the whole way
    reach = min(0.8 * fastest / focal_px, math.radians(12))
    sign = rng.choice([-1, 1], 3)
    turns = (sign[0] * reach, sign[1] * reach / 8, sign[2] * math.radians(rng.uniform(0.5, 2)) * min(1, frames / 100))
    drift = rng.uniform(-1, 1, 3) * (15, 15, 10) * min(1, frames / 100)
    return _Sway(base, target - distance_mm * base[2], turns, drift, duration_s)


def default_scene(
    lattice: TubeLattice, rng: np.random.Generator, *, size_px: tuple[int, int] = (640, 480), rate_hz: float = 25.0,
    frames: int = 150, interlaced: bool = False, bits: int = 8, look: Look = NOMINAL, pitch_px: float | None = None,
) -> Scene:  # fmt: skip
    """Draw a whole inspection at random: 0.6 to 1.4 m off, 25 to 60 px a pitch in a 640 px wide picture, either lens.

    Parameters
    ----------
    lattice
        Tubes.
    rng
        Decides everything else.
    size_px
        Width and height; the sensor is 3.584 mm wide (5.6 um pixels at 640).
    rate_hz, interlaced, bits, look
        As in `Scene`.
    frames
        Length of the way; beyond it the camera goes back.
    pitch_px
        Pitch in the picture; drawn where None.
    """
    distance_mm = rng.uniform(600, 1400)
    if pitch_px is None:
        pitch_px = rng.uniform(25, 60) * size_px[0] / 640
    pixel_mm = SENSOR_WIDTH_MM / size_px[0]
    optics = _draw_optics(size_px, pixel_mm, pitch_px * distance_mm / lattice.pitch_mm * pixel_mm, rng)
    way = there_and_back(
        optics, lattice, distance_mm=distance_mm, duration_s=frames / rate_hz, rate_hz=rate_hz, rng=rng
    )
    poses = [way(i / rate_hz) for i in range(0, frames + 1, max(1, frames // 32))]
    first, shape = _sites_in_view(optics, lattice, poses)
    sheet = make_sheet(lattice, first, shape, look, rng)
    return Scene(optics, sheet, look, way, rate_hz=rate_hz, interlaced=interlaced, bits=bits, rng=rng)


def _draw_optics(size_px: tuple[int, int], pixel_mm: float, focal_length_mm: float, rng: np.random.Generator) -> Optics:
    """A lens with up to 2 % of barrel distortion in the picture's corner, its axis a little off the middle."""
    (w, h), corner_mm = size_px, pixel_mm * math.hypot(*size_px) / 2
    center = ((w - 1) / 2 + rng.uniform(-0.02, 0.02) * w, (h - 1) / 2 + rng.uniform(-0.02, 0.02) * h)
    bend = rng.uniform(0.002, 0.02)
    tsai = bool(rng.random() < 0.5)
    return Optics(
        w, h, focal_length_mm, (pixel_mm, pixel_mm), center,
        kappa1_per_mm2=bend / corner_mm**2 if tsai else 0.0,
        opencv_distortion=None if tsai else (-bend * (focal_length_mm / corner_mm) ** 2, 0.0, 0.0, 0.0, 0.0),
    )  # fmt: skip


def _sites_in_view(optics: Optics, lattice: TubeLattice, poses: list[Pose]) -> tuple[tuple[int, int], tuple[int, int]]:
    """First (row, column) and shape of the rectangle of lattice sites that the poses see, and two more all round."""
    u, v = np.meshgrid(np.linspace(0, optics.width_px - 1, 9), np.linspace(0, optics.height_px - 1, 9))
    rays = optics.undistort(np.stack([u, v], axis=-1).reshape(-1, 2))
    rays = np.insert(rays[np.isfinite(rays).all(axis=1)], 2, 1.0, axis=1)
    inverse, found = np.linalg.inv(lattice.basis_mm), []
    for rotation, translation in poses:
        camera, direction = -rotation.T @ translation, rays @ rotation
        direction = direction[direction[:, 2] > 0.05 * np.linalg.norm(direction, axis=1)]
        points = camera[:2] - camera[2] * direction[:, :2] / direction[:, 2:]
        found.append((points @ inverse)[:, ::-1])
    sites = np.concatenate(found)
    low, high = np.floor(sites.min(axis=0)) - 2, np.ceil(sites.max(axis=0)) + 3
    middle = np.floor((low + high) / 2)
    low, high = np.maximum(low, middle - MOST_SITES // 2), np.minimum(high, middle + MOST_SITES // 2)
    return (int(low[0]), int(low[1])), (int(high[0] - low[0]), int(high[1] - low[1]))
