"""Follow the sheet from picture to picture; find it anew, by itself, where it was lost."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.acquire import candidates
from service.vision.approach import approach, guides_of
from service.vision.compiled import median_of
from service.vision.edges import start_profile
from service.vision.evidence import CONTRADICTION, SUSPICIOUS, PlaceMap
from service.vision.lock import LEAST_TUBES, MOST_STRAY, Proof, prove
from service.vision.motion import Motion, aligned, centred, looked_at
from service.vision.pose import prior_of
from service.vision.projection import project
from service.vision.refinement import AT_REST, refine
from service.vision.search import search_shift
from service.vision.two_terms import with_two_terms
from service.vision.working import WorkingCamera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.pose import Fit
    from service.vision.refinement import Refined
    from service.vision.stopwatch import Stopwatch
    from service.vision.systematics import Common

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Seen", "Tracker"]

START_WIDTH = 0.2
"""Width of the edge that is looked for about a rough pose, in rim radii."""
ACQUIRE_PASSES = 10
TRACK_PASSES = 3
FEW = 60
"""Tubes that a newly found pose is refined on first: enough to bring all others near their edges."""
TRIES = 3
"""Candidates that are refined before a picture is given up."""
CERTAIN_SHARE = 0.4
"""A candidate that shows this share of its tubes needs no comparison with others."""
SAME_SCALE = math.log(1.1)
"""A candidate as large as a proven one is the same lattice: wrong ones differ by the root of 2 or 3, or by 2."""
KEPT_SHARE = 0.5
"""A pose whose share of measured tubes falls below this part of the last one is looked at again."""
SAFE_GAP = 0.2
"""Pitches off the expected place from which a neighbouring tube may be meant."""
UNSEEN_S = 0.1
"""Time without a pose beyond which the sheet's travel counts."""
AFRESH = 5
"""So many pictures in which what changes slowly is found anew once; odd, so that both fields have their turn."""
CALM = 0.13
"""Edge widths that a prediction may have been off for the next one to be good enough as it is."""
SMOOTH = 0.2
"""How fast the running figures follow a new picture."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What one picture gave.

    Attributes
    ----------
    refined
        The measured pose; None where there is none.
    reason
        Why there is none, in words.
    gap
        How far from its expected place the sheet was found, in pitches; NaN where nothing was expected.
    index_in_doubt
        Whether the index may have slipped, and nothing has shown yet that it has not.
    index
        Its number, see `Measurement`.
    """

    refined: Refined | None
    reason: str | None
    gap: float
    index_in_doubt: bool = False
    index: int = 0


class Tracker:
    """Keeps pose, speed, camera estimate and the look of edges between pictures.

    Parameters
    ----------
    camera
        The full frame's camera, as far as it is known.
    """

    def __init__(self, camera: Camera, lattice: Lattice) -> None:
        self.camera, self.lattice = camera, lattice
        self.motion: Motion | None = None
        self._working = WorkingCamera.of(camera, lattice)
        self._common: Common | None = None
        self._pictures = 0
        self._guides_mm = np.zeros((0, 2))
        self._stray_px = 0.0
        self._radius_px: float | None = None
        self._share = 0.0
        self._index = self._trusted = self._numbered = 0
        self._map = PlaceMap(lattice)

    def copy(self) -> Tracker:
        """A tracker that goes its own way from here; they share the map, all else that it keeps is immutable."""
        return copy(self)

    def motion_px(self, period_ns: int) -> float:
        """How far the picture moves in a frame period at the last speed; NaN before two pictures."""
        if self.motion is None or not self.motion.speed_mm_per_s.any():
            return math.nan
        depth = float(self.motion.rotation[2, :2] @ self.motion.anchor_mm + self.motion.translation_mm[2])
        speed = float(np.hypot(*self.motion.speed_mm_per_s[:2]))
        return speed * period_ns * 1e-9 * float(self._working.camera.vector()[0]) / depth

    def step(self, image: Image, parity: int | None, time_ns: int, watch: Stopwatch, at_rest: float = AT_REST) -> Seen:
        """Measure one picture: track, else search nearby, else acquire. What it shows is put into the map by `learn`.

        Parameters
        ----------
        image
            (h, w) grey, C-contiguous: a frame, or one field of it.
        parity
            0 for the top field, 1 for the bottom one, None for a frame.
        at_rest
            As in `refine`, for what is tracked.
        """
        known = self.camera if parity is None else self.camera.of_field(parity)
        start = self._working.camera if parity is None else self._working.camera.of_field(parity)
        seen = self._track(image, known, start, parity, time_ns, watch, at_rest)
        if seen is None:
            seen = self._acquire(image, known, parity, time_ns, watch)
        if seen.refined is None:
            return seen
        if self.motion is not None and self._may_have_slipped(seen.gap, time_ns):
            self._doubt_index()
        refined = self._settled(seen.refined)
        self.follow(refined, time_ns, found=math.isinf(seen.gap))
        return replace(seen, refined=refined, index_in_doubt=self._doubt, index=self._index)

    @property
    def _doubt(self) -> bool:
        return self._index != self._trusted

    def _doubt_index(self) -> None:
        """Take the index for another one, until it is known to be what it was."""
        self._numbered += 1
        self._index = self._numbered

    def settle_index(self, index: int, shift: tuple[int, int] | None) -> bool:
        """Take somebody's word for an index that is in doubt; what the map knows is held against nothing any more.

        Parameters
        ----------
        index
            The one that is meant; where it is not the present one, or not in doubt, nothing is done.
        shift
            By how many rows and columns its places are less than in the index trusted last; None: that is not known,
            and this one is trusted in place of it.

        Returns
        -------
        bool
            Whether it was done.
        """
        if index != self._index or not self._doubt:
            return False
        if shift is None:
            self._trusted = index
        else:
            self._index = self._trusted
            self._relabel(*shift)
        self._map = PlaceMap(self.lattice)
        return True

    def _relabel(self, rows: int, columns: int) -> None:
        """Go on with places that are so many rows and columns more."""
        step = self.lattice.sheet_points(np.array([rows]), np.array([columns]))[0]
        self.motion = None if self.motion is None else self.motion.relabelled(step)
        self._guides_mm = self._guides_mm + step

    def _may_have_slipped(self, gap: float, time_ns: int) -> bool:
        """Whether the sheet moved so far, unexpected or unseen, that a neighbouring tube may be taken for it."""
        if self.motion is None or gap > SAFE_GAP:
            return True
        unseen_s = (time_ns - self.motion.time_ns) * 1e-9
        return unseen_s > UNSEEN_S and self.motion.travelled_mm(unseen_s) > SAFE_GAP * self.lattice.pitch_mm

    def _settled(self, refined: Refined) -> Refined:
        """Hold a picture against the map of what it should show: a slip is mended where that is beyond doubt."""
        self._pictures += 1
        fit = self._map.fit(refined)
        verdict = self._map.compare(refined) if self._doubt or fit < SUSPICIOUS else None
        if fit < CONTRADICTION and not self._doubt:
            self._doubt_index()
        if verdict is not None and verdict.decisive:
            self._index = self._trusted
            if verdict.slipped:
                refined = refined.shifted(verdict.row, verdict.column, self.lattice)
                self._relabel(verdict.row, verdict.column)
        return refined

    def learn(self, refined: Refined) -> None:
        """Put a picture into the map, unless its index is in doubt."""
        if not self._doubt:
            self._map.learn(refined)

    def _track(
        self, image: Image, known: Camera, start: Camera, parity: int | None, time_ns: int, watch: Stopwatch,
        at_rest: float,
    ) -> Seen | None:  # fmt: skip
        """Measure about the predicted pose, then about the best shift of it; None where the sheet is not there."""
        if self.motion is None or self._common is None or self._radius_px is None:
            return None
        prior = prior_of(known, start.focal_length_mm, start.lens)
        rotation, translation = predicted = self.motion.at(time_ns)
        if self._stray_px > CALM * self._common.profile.width_px:
            rotation, translation = approach(
                image, start, self.lattice, *predicted, self._guides_mm, self._common.profile, self._stray_px
            )
            watch.lap("detect")
        refined = refine(
            image, start, self.lattice, prior, rotation, translation, self._common.profile, passes=TRACK_PASSES,
            watch=watch, before=self._common, afresh=self._pictures % AFRESH == 0, parity=parity, at_rest=at_rest,
        )  # fmt: skip
        if not self._holds(refined):
            rotation, translation = predicted
            shifted = search_shift(image, start.vector(), rotation, translation, self.lattice)
            wide = start_profile(START_WIDTH * self._radius_px)
            watch.lap("detect")
            refined = refine(
                image, start, self.lattice, prior, rotation, shifted, wide, passes=ACQUIRE_PASSES, watch=watch,
                parity=parity,
            )  # fmt: skip
        if refined is None or not self._holds(refined):
            return None
        fit = self._working.pose(refined)
        off = looked_at(fit.rotation, fit.translation_mm) - looked_at(*predicted)
        self._stray_px = self._strayed_px(start, predicted, fit)
        return Seen(refined, None, float(np.hypot(*off)) / self.lattice.pitch_mm)

    def _strayed_px(self, camera: Camera, predicted: tuple[Array, Array], fit: Fit) -> float:
        """How far the prediction was off, px, in the middle of the guides."""
        v = camera.vector()
        off = project(v, *predicted, self._guides_mm) - project(v, fit.rotation, fit.translation_mm, self._guides_mm)
        return median_of(np.hypot(off[:, 0], off[:, 1]))

    def _holds(self, refined: Refined | None) -> bool:
        """Whether a tracked pose shows enough of its tubes, where the last one did."""
        if refined is None or refined.shown < LEAST_TUBES:
            return False
        return refined.share >= KEPT_SHARE * self._share and refined.fit.scatter_factor < MOST_STRAY

    def _acquire(self, image: Image, known: Camera, parity: int | None, time_ns: int, watch: Stopwatch) -> Seen:
        """Find the sheet with nothing to go by, indexed as before where it was known before."""
        best: tuple[Refined, Proof] | None = None
        reason, proven_px = "no tube pattern is seen", math.nan
        tried = 0
        for candidate in candidates(image, known, self.lattice, watch, self._radius_px):
            if best is not None and abs(math.log(candidate.radius_px / proven_px)) < SAME_SCALE:
                continue
            tried += 1
            rotation, translation = self._indexed(candidate.fit, time_ns)
            camera = candidate.fit.camera
            refined = refine(
                image, camera, self.lattice, prior_of(known, camera.focal_length_mm), rotation, translation,
                start_profile(START_WIDTH * candidate.radius_px), passes=ACQUIRE_PASSES, watch=watch,
                parity=parity, few=FEW,
            )  # fmt: skip
            if refined is not None:
                proof = prove(image, refined, self.lattice, candidate.blobs)
                watch.lap("lattice")
                if proof.reason is not None:
                    reason = proof.reason
                elif best is None or refined.shown > best[0].shown:
                    best, proven_px = (refined, proof), candidate.radius_px
            if tried >= TRIES or (best is not None and best[1].share > CERTAIN_SHARE):
                break
        if best is None:
            return Seen(None, reason, math.nan)
        refined = with_two_terms(
            image, known, best[0], self.lattice, START_WIDTH, passes=ACQUIRE_PASSES, watch=watch, parity=parity
        )
        return Seen(refined, None, math.inf if self.motion is not None else math.nan)

    def _indexed(self, fit: Fit, time_ns: int) -> tuple[Array, Array]:
        """Give a newly found pose the index that the last one would give it, or one of its own."""
        if self.motion is None:
            return centred(fit.rotation, fit.translation_mm, self.lattice)
        return aligned(fit.rotation, fit.translation_mm, self.motion.at(time_ns), self.lattice)

    def follow(self, refined: Refined, time_ns: int, *, found: bool = False) -> None:
        """Take a measured pose for the last one.

        One that was `found` anew is thought to stand: its labels may have jumped, which is no speed.
        """
        before, self._working = self._working, self._working.learned(refined)
        fit = self._working.pose(refined)
        anchor = looked_at(fit.rotation, fit.translation_mm)
        if self.motion is None or found or self._working is not before:
            self.motion = Motion.standing(fit.rotation, fit.translation_mm, time_ns, anchor)
        else:
            self.motion = self.motion.moved_to(fit.rotation, fit.translation_mm, time_ns, anchor)
        self._share += (SMOOTH if self._share else 1.0) * (refined.share - self._share)
        self._common = refined.common
        guides = guides_of(
            refined.predicted_px, refined.rims.strength, refined.used, refined.shape[1], refined.shape[0]
        )  # fmt: skip
        self._guides_mm = refined.sites.sheet_mm[guides]
        depth = float(fit.rotation[2, :2] @ anchor + fit.translation_mm[2])
        self._radius_px = self.lattice.rim_radius_mm * float(fit.camera.vector()[0]) / depth
