"""The per-picture pipeline: find or follow the sheet, measure its tubes, say what is known and how well."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import cv2
import numpy as np

from service.vision.camera import Camera, TsaiLens
from service.vision.compiled import packed
from service.vision.estimates import estimates
from service.vision.fields import Interlace, Scan, fields_agree
from service.vision.keyframes import Keyframe
from service.vision.lattice import Arrangement, Lattice
from service.vision.measurement import Doubt, Lock, Measurement, Tubes
from service.vision.projection import project
from service.vision.refinement import AT_REST, WIDEST
from service.vision.selfcalibration import calibrate
from service.vision.staleness import CalibrationWatch
from service.vision.stopwatch import Stopwatch
from service.vision.tracking import Tracker
from service.vision.view import View

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from service.vision.measurement import Pose
    from service.vision.refinement import Refined
    from service.vision.tracking import Seen

    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Measurer", "warm_up"]

PARITY = {"top": 0, "bottom": 1}
FRAME = -1
UNSURE_SCALE = 0.02
BLURRED, BLURRED_PX = 0.2, 2.5
"""Edges wider than this share of a rim's radius, and than so many px, are out of focus; so are all that are wider than
rays can look across."""
DIM_SHARE = 0.25
STALE = 2.0
"""Centres that stray twice as far as they and the tubes' scatter explain speak against the calibration."""
USUAL_PERIOD_NS = 40_000_000
"""Frame period before two frames have told it."""
LONGEST_PERIOD_NS = 200_000_000
MEMORY = ("_tracker", "_calibration", "_interlace", "_time_ns", "_period_ns")


class Measurer:
    """Measures one stream of pictures, with a memory from picture to picture.

    Parameters
    ----------
    camera
        The full frame's camera, as far as it is known.
    lattice
        The tubesheet.
    tick
        Nanoseconds, for the times that stages took.
    at_rest
        Edge widths that a tracked pose may lie from where rims were looked for; nearer takes more looks.
    """

    def __init__(self, camera: Camera, lattice: Lattice, tick: Callable[[], int], *, at_rest: float = AT_REST) -> None:
        self._camera, self._lattice, self._tick, self._at_rest = camera, lattice, tick, at_rest
        self.reset()

    def reset(self) -> None:
        """Forget what earlier pictures showed."""
        self._tracker = Tracker(self._camera, self._lattice)
        self._calibration = CalibrationWatch(self._camera, self._lattice)
        self._interlace = Interlace()
        self._time_ns: int | None = None
        self._period_ns = USUAL_PERIOD_NS

    @property
    def memory(self) -> dict[str, Any]:
        """All that earlier pictures left behind, to be copied before the next one."""
        return {name: getattr(self, name) for name in MEMORY}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from a copy of what `memory` was."""
        for name in MEMORY:
            setattr(self, name, memory[name])

    def settle_index(self, index: int, shift: tuple[int, int] | None) -> bool:
        """See `Tracker.settle_index`; holds from the next picture on."""
        return self._tracker.settle_index(index, shift)

    def measure(self, pixels: Image, time_ns: int, field: str = "unknown") -> list[Measurement]:
        """Measure a picture.

        Parameters
        ----------
        pixels
            (h, w) grey, 8 or 16 bit: a frame, or the lines of one field.
        time_ns
            When it was exposed; for an interlaced frame, its first field.
        field
            progressive | interlaced-top-first | interlaced-bottom-first | top | bottom, or unknown: then the pictures
            decide.

        Returns
        -------
        list
            One answer, or one for each field in the order of time.
        """
        self._clocked(time_ns)
        if field in PARITY:
            return [self._answer(packed(pixels), PARITY[field], time_ns)]
        if field == "progressive":
            return [self._answer(packed(pixels), None, time_ns)]
        if field.startswith("interlaced"):
            return self._fields(pixels, time_ns, top_first=field == "interlaced-top-first")
        if self._interlace.scan is Scan.PROGRESSIVE:
            return [self._answer(packed(pixels), None, time_ns)]
        if self._interlace.scan is Scan.INTERLACED:
            return self._fields(pixels, time_ns, top_first=self._interlace.top_first)
        return self._undecided(pixels, time_ns)

    def _clocked(self, time_ns: int) -> None:
        """Learn the frame period."""
        if self._time_ns is not None and 0 < time_ns - self._time_ns < LONGEST_PERIOD_NS:
            self._period_ns = time_ns - self._time_ns
        self._time_ns = time_ns

    def _fields(self, pixels: Image, time_ns: int, *, top_first: bool) -> list[Measurement]:
        """Answer for each field, in the order of time."""
        seen: dict[int, Seen] = {}
        answers = []
        for later, parity in enumerate((0, 1) if top_first else (1, 0)):
            at = time_ns + later * self._period_ns // 2
            answers.append(self._answer(packed(pixels[parity::2]), parity, at, seen))
        self._interlace.ordered(seen[0].refined, seen[1].refined)
        return answers

    def _undecided(self, pixels: Image, time_ns: int) -> list[Measurement]:
        """Answer for a frame of which nobody knows whether it is interlaced, and find that out."""
        whole, before = packed(pixels), self._tracker
        self._tracker = before.copy()
        seen: dict[int, Seen] = {}
        answer = self._answer(whole, None, time_ns, seen, learn=False)  # a comb may have moved it
        refined, motion_px = seen[FRAME].refined, self._tracker.motion_px(self._period_ns)
        if refined is not None and fields_agree(whole, refined, self._lattice):
            self._interlace.agreed(motion_px)
            self._tracker.learn(refined)
            return [answer]
        top, bottom = self._both_fields(whole, refined, before, time_ns)
        self._interlace.compared(refined, top, bottom, motion_px)
        if self._interlace.scan is not Scan.INTERLACED or top is None:
            if refined is not None:
                self._tracker.learn(refined)
            return [answer]
        self._tracker = before
        self._tracker.follow(top, time_ns)
        return self._fields(pixels, time_ns, top_first=self._interlace.top_first)

    def _both_fields(
        self, whole: Image, refined: Refined | None, before: Tracker, time_ns: int
    ) -> tuple[Refined | None, Refined | None]:
        """Measure top and bottom field, each about the frame's pose; where that shows none, one about the other.

        A bottom field has nothing to tell where the top one shows no pattern.
        """
        tracker = before.copy()
        if refined is not None:
            tracker.follow(refined, time_ns)
        top = tracker.step(packed(whole[0::2]), 0, time_ns, Stopwatch(self._tick)).refined
        if top is None:
            return None, None
        return top, tracker.step(packed(whole[1::2]), 1, time_ns, Stopwatch(self._tick)).refined

    def _answer(
        self, image: Image, parity: int | None, time_ns: int, seen: dict[int, Seen] | None = None, *, learn: bool = True
    ) -> Measurement:
        """Measure one picture and say what is known of it; `learn`: put it into the map of places."""
        watch = Stopwatch(self._tick)
        found = self._tracker.step(image, parity, time_ns, watch, self._at_rest)
        if seen is not None:
            seen[FRAME if parity is None else parity] = found
        name = "progressive" if parity is None else ("top", "bottom")[parity]
        if learn and found.refined is not None:
            self._tracker.learn(found.refined)
        if found.refined is None:
            return Measurement(name, Lock.NONE, found.reason, (), Tubes.none(), None, time_ns, watch.elapsed_ms())
        pose, tubes = estimates(found.refined, self._lattice, self._camera, parity)
        doubt = doubts(found, found.refined, pose, self._lattice, self._calibration.look(found.refined))
        lock = Lock.PARTIAL if doubt else Lock.FULL
        watch.lap("pose")
        view = View.of(found.refined)
        return Measurement(name, lock, None, doubt, tubes, pose, time_ns, watch.elapsed_ms(), view, found.index)


def doubts(seen: Seen, refined: Refined, pose: Pose, lattice: Lattice, stale: bool) -> tuple[Doubt, ...]:
    """What a locked pose is unsure of; `stale`: whether pictures have contradicted the calibration."""
    radius = lattice.rim_radius_mm * refined.scale
    found = {
        Doubt.INDEX: seen.index_in_doubt,
        Doubt.SCALE: pose.sigma.distance_mm > UNSURE_SCALE * pose.distance_mm,
        Doubt.FOCUS: refined.common.profile.blur_px > min(max(BLURRED * radius, BLURRED_PX), WIDEST * radius),
        Doubt.LIGHT: refined.share < DIM_SHARE,
        Doubt.CALIBRATION: stale or refined.fit.scatter_factor > STALE,
    }
    return tuple(doubt for doubt, there in found.items() if there)


def warm_up(tick: Callable[[], int]) -> None:
    """Compile every kernel, or load it from the cache of an earlier run: before the first frame, never in its way."""
    lattice = Lattice(Arrangement.TRIANGULAR, 25.4, 8.4, 9.5)
    camera = Camera((320, 240), (0.01, 0.01), 8.0, TsaiLens(), (159.5, 119.5))
    unknown = Camera(camera.image_size_px, camera.pixel_pitch_mm)
    standing, jumped = _sketch(camera, lattice, 0.0), _sketch(camera, lattice, 0.45)
    for known, scale in ((camera, 1), (camera, 257), (unknown, 1)):
        measurer = Measurer(known, lattice, tick)
        seen: list[Measurement] = []
        for k, picture in enumerate((standing, standing, standing, jumped, jumped)):
            pixels = picture if scale == 1 else picture.astype(np.uint16) * np.uint16(scale)
            seen += measurer.measure(pixels, k * USUAL_PERIOD_NS)
    calibrate([Keyframe.of(m, lattice, 0) for m in seen], unknown, lattice)


def _sketch(camera: Camera, lattice: Lattice, pitches: float) -> NDArray[np.uint8]:
    """Draw a sheet so many pitches aside, with a place where no tube is."""
    rows, columns = (a.ravel() for a in np.mgrid[-8:9, -8:9])
    sheet = lattice.sheet_points(rows, columns)[(rows != 1) | (columns != 1)]
    aside = np.array([pitches * lattice.pitch_mm, 0.0, 700.0])
    picture = np.full(camera.image_size_px[::-1], 160, np.uint8)
    for x, y in project(camera.vector(), np.eye(3), aside, sheet):
        cv2.circle(picture, (round(16 * x), round(16 * y)), round(16 * 9.6), 20, -1, cv2.LINE_AA, 4)
    return picture
