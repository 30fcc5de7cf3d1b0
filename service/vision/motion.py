"""How the sheet moves before the camera: prediction, and keeping the lattice index from frame to frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled
from service.vision.pose import turned

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Motion", "aligned", "centred"]


ACCELERATION_MM_PER_S2 = 200.0
"""What an arm may do while nobody looks."""
STEADIER = 0.7
"""What part of the error that a prediction at constant speed had, one at a constantly growing speed must have had for
the next to be made so: an arm that starts or stops grows faster steadily, a shaken one does not."""
GROWS_S = 0.1
"""For how long at the most a speed is thought to grow: after an outage the arm may be anywhere."""
LEAST_S = 1e-3
"""Pictures nearer in time tell no speed: where frames were passed over, a field may seem to be as old as the next."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A pose at a time, with the speed it moves at.

    Attributes
    ----------
    rotation, translation_mm
        camera_from_sheet at `time_ns`.
    anchor_mm
        (2,) the sheet point whose motion is followed: what the picture's middle looks at.
    turn_per_s, speed_mm_per_s
        (3,) rotation vector (rad) and (3,) velocity of the anchor, both in the camera frame.
    turn_trend_per_s2, speed_trend_mm_per_s2
        (3,) by how much both grew last.
    grows
        Whether they are thought to go on growing so.
    """

    rotation: NDArray[np.float64]
    translation_mm: NDArray[np.float64]
    anchor_mm: NDArray[np.float64]
    time_ns: int
    turn_per_s: NDArray[np.float64]
    speed_mm_per_s: NDArray[np.float64]
    turn_trend_per_s2: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    speed_trend_mm_per_s2: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    grows: bool = False

    def at(self, time_ns: int) -> tuple[Array, Array]:
        """Predict the pose: at the last speed, or, for a short while, at one that has grown as it did last."""
        dt = (time_ns - self.time_ns) * 1e-9
        rotation, translation = np.empty((3, 3)), np.empty(3)
        _predict(
            self.rotation, self.translation_mm, self.anchor_mm, self.turn_per_s, self.speed_mm_per_s,
            self.turn_trend_per_s2, self.speed_trend_mm_per_s2, dt, dt if self.grows and dt < GROWS_S else 0.0,
            rotation, translation,
        )  # fmt: skip
        return rotation, translation

    def moved_to(self, rotation: Array, translation_mm: Array, time_ns: int, anchor_mm: Array) -> Motion:
        """The motion after a new measured pose."""
        dt = (time_ns - self.time_ns) * 1e-9
        if dt < LEAST_S:
            return replace(self, rotation=rotation, translation_mm=translation_mm, anchor_mm=anchor_mm, time_ns=time_ns)
        turn, speed, turn_trend, speed_trend = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        grows = _speeds(
            self.rotation, self.translation_mm, rotation, translation_mm, anchor_mm, dt, self.turn_per_s,
            self.speed_mm_per_s, self.turn_trend_per_s2, self.speed_trend_mm_per_s2, turn, speed, turn_trend,
            speed_trend,
        )  # fmt: skip
        return Motion(rotation, translation_mm, anchor_mm, time_ns, turn, speed, turn_trend, speed_trend, grows)

    def relabelled(self, step_mm: Array) -> Motion:
        """The same motion where every tube's nominal place has grown by (2,) mm: an index mended is no travel."""
        translation = self.translation_mm - self.rotation[:, :2] @ step_mm
        return replace(self, translation_mm=translation, anchor_mm=self.anchor_mm + step_mm)

    def travelled_mm(self, seconds: float) -> float:
        """How far the sheet may have moved across the view: at the last speed, or from rest."""
        return float(np.hypot(*self.speed_mm_per_s[:2])) * seconds + 0.5 * ACCELERATION_MM_PER_S2 * seconds**2

    @staticmethod
    def standing(rotation: Array, translation_mm: Array, time_ns: int, anchor_mm: Array) -> Motion:
        """A first pose, of which no speed is known."""
        return Motion(rotation, translation_mm, anchor_mm, time_ns, np.zeros(3), np.zeros(3))


@compiled
def _predict(
    R: Array, t: Array, anchor: Array, turn: Array, speed: Array, turn_trend: Array, speed_trend: Array, dt: float,
    grown: float, rotation: Array, translation: Array,
) -> None:  # fmt: skip
    """The pose after `dt` at speeds that have grown for `grown` s."""
    rotation[:] = turned(R, (turn + turn_trend * grown) * dt)
    for i in range(3):
        there = R[i, 0] * anchor[0] + R[i, 1] * anchor[1] + t[i] + (speed[i] + speed_trend[i] * grown) * dt
        translation[i] = there - rotation[i, 0] * anchor[0] - rotation[i, 1] * anchor[1]


@compiled
def _speeds(
    R0: Array, t0: Array, R1: Array, t1: Array, anchor: Array, dt: float, last_turn: Array, last_speed: Array,
    last_turn_trend: Array, last_speed_trend: Array, turn: Array, speed: Array, turn_trend: Array, speed_trend: Array,
) -> bool:  # fmt: skip
    """Speeds between two poses, and how they grew; whether they go on growing as they did.

    Turn and shift are added up as seen in the sheet.
    """
    between = R1 @ R0.T
    turn[0], turn[1] = between[2, 1] - between[1, 2], between[0, 2] - between[2, 0]
    turn[2] = between[1, 0] - between[0, 1]
    sine = 0.5 * math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    angle = math.atan2(sine, 0.5 * (between[0, 0] + between[1, 1] + between[2, 2] - 1.0))
    turn *= 0.5 * (angle / sine if sine > 1e-9 else 1.0) / dt
    constant, growing = np.zeros(2), np.zeros(2)
    for i in range(3):
        before = R0[i, 0] * anchor[0] + R0[i, 1] * anchor[1] + t0[i]
        speed[i] = (R1[i, 0] * anchor[0] + R1[i, 1] * anchor[1] + t1[i] - before) / dt
        turn_trend[i], speed_trend[i] = (turn[i] - last_turn[i]) / dt, (speed[i] - last_speed[i]) / dt
        constant[0] += turn_trend[i] ** 2
        constant[1] += speed_trend[i] ** 2
        growing[0] += (turn_trend[i] - last_turn_trend[i]) ** 2
        growing[1] += (speed_trend[i] - last_speed_trend[i]) ** 2
    steady = math.sqrt(growing[1]) + t0[2] * math.sqrt(growing[0])
    return bool(steady < STEADIER * (math.sqrt(constant[1]) + t0[2] * math.sqrt(constant[0])))


@compiled
def looked_at(rotation: Array, translation_mm: Array) -> Array:
    """Where the optical axis meets the sheet, (2,) mm."""
    out, depth = np.empty(2), 0.0
    for k in range(3):
        depth -= rotation[k, 2] * translation_mm[k]
    for c in range(2):
        foot = 0.0
        for k in range(3):
            foot -= rotation[k, c] * translation_mm[k]
        out[c] = foot - rotation[2, c] * depth / rotation[2, 2]
    return out


def centred(rotation: Array, translation_mm: Array, lattice: Lattice) -> tuple[Array, Array]:
    """The same view with the lattice origin at the tube nearest the optical axis and X as near rightwards as may be.

    From a picture alone the lattice is known up to its symmetry: the first frame chooses so.
    """
    upright = np.eye(3)
    rotation = _turned_nearest(rotation, upright, lattice)
    index = np.rint(lattice.lattice_coordinates(looked_at(rotation, translation_mm)[None]))[0]
    return rotation, translation_mm + rotation[:, :2] @ lattice.sheet_points(index[:1], index[1:])[0]


def aligned(
    rotation: Array, translation_mm: Array, reference: tuple[Array, Array], lattice: Lattice
) -> tuple[Array, Array]:
    """The same view, indexed as `reference` would have it, and how far from that it lies.

    Returns
    -------
    rotation, translation_mm
        Turned by lattice turns and shifted by lattice vectors to come nearest to the reference pose.
    distance
        What remains between the two at the picture's middle, in pitches: beyond half a pitch the index is a guess.
    """
    rotation = _turned_nearest(rotation, reference[0], lattice)
    here = looked_at(rotation, translation_mm)
    there = looked_at(*reference)
    index = np.rint(lattice.lattice_coordinates((here - there)[None]))[0]
    shift = lattice.sheet_points(index[:1], index[1:])[0]
    return rotation, translation_mm + rotation[:, :2] @ shift


def _turned_nearest(rotation: Array, reference: Array, lattice: Lattice) -> Array:
    """The lattice turn of `rotation` (about the sheet's normal) that comes nearest to `reference`."""
    step = 2 * math.pi / lattice.arrangement.symmetry
    between = reference.T @ rotation
    turns = round(math.atan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1]) / step)
    c, s = math.cos(turns * step), math.sin(turns * step)
    return np.ascontiguousarray(rotation @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))
