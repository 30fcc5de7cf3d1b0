"""What of an alignment is an alarm, with its figure, its limit and what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

from service.alignment.alarms import Condition
from service.alignment.bands import Bands, Grade
from service.alignment.targets import NEAREST
from service.alignment.verdict import Verdict
from service.vision.measurement import TubeState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.alignment.result import Alignment

__all__ = ["alignment_conditions"]

SETTLING_S = 0.5
"""What comes and goes faster than this is no alarm: a hose that swings by, a single frame without a lock."""


def alignment_conditions(alignment: Alignment, bands: Bands) -> Sequence[Condition]:
    """What is wrong in this picture, what explains the others first.

    The bands are alarms where a target was chosen: on the way over the sheet, the nearest tube is passed, not missed.
    """
    j = alignment.judgement
    if alignment.verdict is Verdict.STALE:
        return [Condition("stale", j.reasons[0], "stop moving; check camera, cable and grabber", after_s=0.0)]
    if alignment.verdict is Verdict.NO_LOCK:
        return [Condition("no-lock", f"no lock: {j.reasons[0]}", _todo(alignment), after_s=SETTLING_S)]
    if alignment.verdict is Verdict.CANNOT_JUDGE:
        reason = "cannot judge: " + "; ".join(j.reasons)
        return [Condition("cannot-judge", reason, _todo(alignment), after_s=SETTLING_S)]
    figures = [] if alignment.target == str(NEAREST) else _figures(alignment, bands)
    return [c for c in (_target(alignment), *figures) if c is not None]


def _todo(alignment: Alignment) -> str:
    return ", or ".join(str(h) for h in alignment.judgement.helps) or "look at the picture"


def _target(alignment: Alignment) -> Condition | None:
    if alignment.state is TubeState.PLUGGED:
        return Condition("plugged", f"target {_tube(alignment)} is plugged", "choose another tube", after_s=SETTLING_S)
    if alignment.state is TubeState.ABSENT:
        return Condition("absent", f"no tube is seen at {_tube(alignment)}", "check the anchor", after_s=SETTLING_S)
    return None


def _tube(alignment: Alignment) -> str:
    return str(alignment.name) if alignment.name is not None else f"place {alignment.place}"


def _figures(alignment: Alignment, bands: Bands) -> Sequence[Condition | None]:
    lean, hit, j, p = alignment.lean, alignment.entry, alignment.judgement, alignment.parallelism
    assert lean is not None, "a judged alignment has its figures"
    assert hit is not None, "a judged alignment has its figures"
    move = f"move the guide: {j.advice}" if j.advice else "move the guide"
    found: list[Condition | None] = []
    if hit.margin_mm < 0:
        found.append(
            Condition("entry", "the probe would touch the tube end", move, hit.margin_mm, 0.0, "mm", SETTLING_S)
        )
    if j.offset_grade is Grade.ALARM:
        limit = bands.offset_advisory_mm
        found.append(Condition("offset", "the guide is off the tube", move, lean.distance_mm, limit, "mm", SETTLING_S))
    if j.tilt_grade is Grade.ALARM:
        limit = bands.tilt_advisory_deg
        found.append(
            Condition("tilt", "the guide leans against the tube", move, lean.tilt_deg, limit, "deg", SETTLING_S)
        )
    if p is not None and p.deg > bands.parallelism_normal_deg + bands.margin_sigmas * p.sigma_deg:
        limit, todo = bands.parallelism_normal_deg, "level the arm"
        found.append(Condition("parallelism", "the arm is not parallel to the sheet", todo, p.deg, limit, "deg", 1.0))
    return found
