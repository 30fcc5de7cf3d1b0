"""How the sheet moves before the camera: prediction, and keeping the lattice index from frame to frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np

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
        turn_per_s, speed = self.turn_per_s, self.speed_mm_per_s
        if self.grows and dt < GROWS_S:
            turn_per_s, speed = turn_per_s + self.turn_trend_per_s2 * dt, speed + self.speed_trend_mm_per_s2 * dt
        turn = np.asarray(cv2.Rodrigues(turn_per_s * dt)[0], np.float64)
        rotation = np.ascontiguousarray(turn @ self.rotation)
        anchor = self.rotation[:, :2] @ self.anchor_mm + self.translation_mm + speed * dt
        return rotation, anchor - rotation[:, :2] @ self.anchor_mm

    def moved_to(self, rotation: Array, translation_mm: Array, time_ns: int, anchor_mm: Array) -> Motion:
        """The motion after a new measured pose."""
        dt = (time_ns - self.time_ns) * 1e-9
        if dt < LEAST_S:
            return replace(self, rotation=rotation, translation_mm=translation_mm, anchor_mm=anchor_mm, time_ns=time_ns)
        turn = np.asarray(cv2.Rodrigues(rotation @ self.rotation.T)[0], np.float64).ravel() / dt
        before = self.rotation[:, :2] @ anchor_mm + self.translation_mm
        speed = (rotation[:, :2] @ anchor_mm + translation_mm - before) / dt
        more_turn, more_speed = turn - self.turn_per_s, speed - self.speed_mm_per_s
        constant = self._size_mm(more_turn, more_speed)
        growing = self._size_mm(more_turn - self.turn_trend_per_s2 * dt, more_speed - self.speed_trend_mm_per_s2 * dt)
        return Motion(
            rotation, translation_mm, anchor_mm, time_ns, turn, speed, more_turn / dt, more_speed / dt,
            growing < STEADIER * constant,
        )  # fmt: skip

    def _size_mm(self, turn: Array, shift_mm: Array) -> float:
        """How large a turn and a shift are together, seen in the sheet."""
        return float(np.sqrt(shift_mm @ shift_mm) + self.translation_mm[2] * np.sqrt(turn @ turn))

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


def looked_at(rotation: Array, translation_mm: Array) -> Array:
    """Where the optical axis meets the sheet, (2,) mm."""
    center = -rotation.T @ translation_mm
    axis = rotation[2]
    return np.asarray(center[:2] - axis[:2] * center[2] / axis[2])


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
