"""Interlaced video: a frame of two fields, exposed half a frame apart, and how to tell that it is one.

A comb detector confuses noise with motion. Here the two fields are measured on their own, and what tells is whether
the same tubes stand in different places.
"""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import packed
from service.vision.rims import accepted, measure_rims

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice
    from service.vision.refinement import Refined

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Interlace", "Scan", "field_motion", "fields_agree"]

LEAST_MOTION_PX = 0.2
"""A smaller difference between fields is left to the codec."""
SURE = 6.0
"""Standard errors that the difference must exceed."""
MOVED_PX = 1.5
"""Motion from frame to frame that two fields would have shown, if there were two."""
STEADY = 10
"""So many moving frames without a difference between fields, and the video is progressive."""
LOOKED_AT = 60
"""Tubes, at the most, that are looked at to see whether both fields show them in the same places."""
COMMON = 8
"""Least tubes that both fields must show."""


class Scan(enum.Enum):
    """What is known of a video's scan."""

    UNDECIDED = enum.auto()
    PROGRESSIVE = enum.auto()
    INTERLACED = enum.auto()


class Interlace:
    """Decides from the pictures whether a video is interlaced, and which field comes first; then keeps to it."""

    def __init__(self) -> None:
        self.scan = Scan.UNDECIDED
        self.top_first = True
        self._steady = 0
        self._whole, self._torn = False, False
        self._order = 0.0
        self._last_top: Refined | None = None

    def compared(
        self, frame: Refined | None, top: Refined | None, bottom: Refined | None, frame_motion_px: float
    ) -> None:
        """Learn from one frame and its two fields, while the scan is undecided.

        Parameters
        ----------
        frame, top, bottom
            What each showed; a frame without a pattern whose top field has one is two pictures in one. Where frames
            have shown one before, it takes two in a row: after a leap the field may just have been found sooner.
        frame_motion_px
            How far the picture moved since the frame before; NaN where that is not known.
        """
        if frame is None and top is not None:
            if self._torn or not self._whole:
                self.scan = Scan.INTERLACED
            self._torn = True
            return
        self._torn = False
        self._whole = self._whole or frame is not None
        motion = None if top is None or bottom is None else field_motion(top, bottom)
        if motion is None:
            return
        if motion.clear:
            self.scan = Scan.INTERLACED
        else:
            self._stood(frame_motion_px)

    def agreed(self, frame_motion_px: float) -> None:
        """Learn from one frame in whose fields the same tubes stand in the same places."""
        self._torn, self._whole = False, True
        self._stood(frame_motion_px)

    def _stood(self, frame_motion_px: float) -> None:
        if frame_motion_px > MOVED_PX:
            self._steady += 1
            if self._steady >= STEADY:
                self.scan = Scan.PROGRESSIVE

    def ordered(self, top: Refined | None, bottom: Refined | None) -> None:
        """Learn the order of the fields: the motion inside a frame goes with that between frames, or against it."""
        if top is not None and bottom is not None and self._last_top is not None:
            inside, between = field_motion(top, bottom), top_motion(self._last_top, top)
            if inside is not None and between is not None and between.length_px > LEAST_MOTION_PX:
                along = float(inside.mean_px @ between.mean_px) / between.length_px
                self._order = 0.8 * self._order + along
                if abs(self._order) > LEAST_MOTION_PX:
                    self.top_first = self._order > 0
        self._last_top = top


class FieldMotion:
    """Mean motion of the tubes that two pictures share.

    Attributes
    ----------
    mean_px
        (2,) in the frame's lines.
    clear
        Whether it is more than noise and codec explain.
    """

    def __init__(self, difference_px: Array) -> None:
        middle = np.median(difference_px, axis=0)
        stray = 1.4826 * np.median(np.abs(difference_px - middle), axis=0)
        self.mean_px = middle
        self.length_px = float(np.hypot(*middle))
        error = 1.25 * float(np.hypot(*stray)) / math.sqrt(len(difference_px))
        self.clear = self.length_px > LEAST_MOTION_PX + SURE * error


def fields_agree(frame: Image, refined: Refined, lattice: Lattice) -> bool:
    """Whether some of a frame's tubes stand in the same places in both of its fields, by one look at each.

    Only where they may not do fields have to be measured on their own.
    """
    used = np.flatnonzero(refined.used)
    asked = refined.sites.sheet_mm[used[np.linspace(0, len(used) - 1, min(LOOKED_AT, len(used))).astype(np.int64)]]
    fit, profile = refined.fit, refined.common.profile
    shifts, seen = [], np.ones(len(asked), np.bool_)
    for parity in (0, 1):
        vector = fit.camera.of_field(parity).vector()
        field = packed(frame[parity::2])
        rims = measure_rims(field, vector, fit.rotation, fit.translation_mm, asked, lattice, profile)
        seen &= accepted(rims, profile.width_px)
        shifts.append(rims.shift_px)
    if seen.sum() < max(COMMON, len(asked) / 2):
        return False
    return FieldMotion((shifts[1] - shifts[0])[seen] * [1.0, 2.0]).length_px < LEAST_MOTION_PX


def field_motion(top: Refined, bottom: Refined) -> FieldMotion | None:
    """Motion from the top to the bottom field; None where they share too few tubes."""
    return _motion(top, bottom, 0.0, 1.0)


def top_motion(before: Refined, now: Refined) -> FieldMotion | None:
    """Motion from one top field to the next."""
    return _motion(before, now, 0.0, 0.0)


def _motion(a: Refined, b: Refined, line_a: float, line_b: float) -> FieldMotion | None:
    at = {key: i for i, key in enumerate(zip(a.sites.row.tolist(), a.sites.column.tolist(), strict=True)) if a.used[i]}
    pairs = [
        (at[key], j)
        for j, key in enumerate(zip(b.sites.row.tolist(), b.sites.column.tolist(), strict=True))
        if b.used[j] and key in at
    ]
    if len(pairs) < COMMON:
        return None
    i, j = np.array(pairs).T
    return FieldMotion((b.rims.center_px[j] - a.rims.center_px[i]) * [1.0, 2.0] + [0.0, line_b - line_a])
