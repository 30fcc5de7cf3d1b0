"""Results of a session's frames, measured again, against those that were recorded: the same to the last bit, or not."""

from __future__ import annotations

import json
import math
from collections import Counter
from statistics import median
from typing import TYPE_CHECKING, Any

from service.sinks.base import SinkStats
from service.sinks.evidence import without_times

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.sinks.session.reader import Answered, RecordedSession

__all__ = ["Comparison", "exact_text"]

POSE_FIGURES = (("distance_mm", "mm"), ("tilt_deg", "deg"), ("focal_length_mm", "mm"))


def exact_text(line: Mapping[str, Any]) -> str:
    """Write a result line without `elapsed_ms` in the one way there is: equal texts are equal to the last bit."""
    return json.dumps(without_times(line), sort_keys=True, allow_nan=False)


class Comparison:
    """A sink that holds each result against the recorded one. What took how long is not compared.

    Frames after one that the recorder lost were measured with a memory of frames that are not there, and so are those
    before the first restart in a session that began in the midst of a watch, where what was remembered then is not
    known: where they differ, that is counted apart.

    Parameters
    ----------
    session
        What was recorded.
    remembered
        Whether it is measured again with what was remembered when it began.
    """

    name = "comparison"

    def __init__(self, session: RecordedSession, *, remembered: bool = False) -> None:
        self._answers: Iterator[Answered] = session.answers()
        self._generation = 0
        self.exact = session.about.from_start or remembered
        """Whether the frames so far are all that the results so far were measured from."""
        self._over = False
        self.equal = self.different = self.inexact = self.damaged = 0
        """Frames that are equal; that differ; that differ and were measured with more than is recorded; without a
        sound picture or result line."""
        self.first_difference: str | None = None
        self.locks: Counter[str] = Counter()
        self._moved: dict[str, list[float]] = {}
        self._accepted = 0

    @property
    def compared(self) -> int:
        """Frames held against their record."""
        return self.equal + self.different + self.inexact + self.damaged

    @property
    def same(self) -> bool:
        """Whether all that could be compared is equal, and something was."""
        return self.different == 0 and self.damaged == 0 and self.equal > 0

    @property
    def problem(self) -> str | None:
        """Why it is not the same, in a line; None where it is."""
        if self.same:
            return None
        if self.first_difference is not None:
            return self.first_difference
        if self.inexact:
            return (
                "no result can be held to the last bit: frames that were measured before are not recorded; "
                "record from the start (--record) where that is wanted"
            )
        return "nothing could be measured again"

    def start(self) -> None:
        """Take nothing."""

    def accept(self, frame: Frame, results: Sequence[FrameResult]) -> None:
        """Compare the results of the next frame."""
        self._accepted += 1
        if (was := self._next(frame)) is not None:
            self.hold_against(was, frame.defect, [json.loads(result.to_json()) for result in results])

    def _next(self, frame: Frame) -> Answered | None:
        """What was recorded of a frame; None once the record is at its end, when it is played again."""
        while not self._over:
            was = next(self._answers, None)
            if was is None:
                self._over = True
            elif was.row is None:
                self.exact = False
            elif (was.row.timestamp_ns, was.row.field) == (frame.timestamp_ns, frame.field):
                if was.row.generation != self._generation:
                    self.exact, self._generation = self.exact or self._generation != 0, was.row.generation
                return was
        return None

    def hold_against(self, was: Answered, defect: str | None, now: Sequence[Mapping[str, Any]]) -> None:
        """Compare the lines of one frame."""
        assert was.row is not None, "recorded"
        if was.problem is not None or defect != was.row.defect:
            self._note(f"frame {was.row.number}: {was.problem or defect}")
            self.damaged, self.exact = self.damaged + 1, False
            return
        if [exact_text(line) for line in was.lines] == [exact_text(line) for line in now]:
            self.equal += 1
            return
        if self.exact:
            self.different += 1
            self._note(f"frame {was.row.number}: {_first_difference(was.lines, now)}")
        else:
            self.inexact += 1
        for before, after in zip(was.lines, now, strict=False):
            self._moves(before, after)

    def _note(self, text: str) -> None:
        self.first_difference = self.first_difference or text

    def _moves(self, before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
        """Note how far two lines are apart."""
        if before["lock"] != after["lock"]:
            self.locks[f"{before['lock']} to {after['lock']}"] += 1
        if before["pose"] is not None and after["pose"] is not None:
            for key, unit in POSE_FIGURES:
                self._moved.setdefault(f"{key.rpartition('_')[0]} {unit}", []).append(
                    abs(after["pose"][key] - before["pose"][key])
                )
        offsets = [(line["alignment"] or {}).get("offset_mm") for line in (before, after)]
        if offsets[0] is not None and offsets[1] is not None:
            self._moved.setdefault("offset mm", []).append(math.dist(offsets[0], offsets[1]))
        places = {(t["row"], t["column"]): (t["x_px"], t["y_px"]) for t in before["tubes"]}
        apart = [
            math.dist(places[at], (t["x_px"], t["y_px"]))
            for t in after["tubes"]
            if (at := (t["row"], t["column"])) in places
        ]
        if apart:
            self._moved.setdefault("tube centres px", []).append(median(apart))

    def lines(self) -> list[str]:
        """What came of it, for the summary."""
        said = [f"{self.equal:,} frames equal to the last bit"]
        said += [f"{self.different:,} differ"] if self.different else []
        said += [f"{self.inexact:,} differ after frames that are not recorded"] if self.inexact else []
        said += [f"{self.damaged:,} damaged"] if self.damaged else []
        lines = [f"  recorded     {', '.join(said)} (elapsed_ms is not compared)"]
        if self.first_difference is not None:
            lines.append(f"               first: {self.first_difference}")
        elif self.compared and self.problem is not None:
            lines.append(f"               {self.problem}")
        if self.locks:
            lines.append(f"  lock changed {', '.join(f'{count:,} {what}' for what, count in self.locks.items())}")
        for what, apart in self._moved.items():
            lines.append(f"  {what}: apart by {median(apart):.4g} (median), {max(apart):.4g} (most)")
        return lines

    def close(self, timeout_s: float) -> None:  # noqa: ARG002 - nothing waits
        """Let go. May be repeated."""
        self._over = True

    def stats(self) -> SinkStats:
        """Frames seen."""
        return SinkStats(accepted=self._accepted)


def _first_difference(before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]]) -> str:
    """The first key of two results whose values differ, and both values."""
    if len(before) != len(after):
        return f"{len(before)} lines were recorded, {len(after)} came now"
    for was, now in zip(before, after, strict=True):
        for path, a, b in _differences(without_times(was), without_times(now), ""):
            return f"{path} was {_short(a)}, is {_short(b)}"
    return "the lines differ in how they are written"


def _differences(a: object, b: object, path: str) -> Iterator[tuple[str, object, object]]:
    if isinstance(a, dict) and isinstance(b, dict):
        for key in [*a, *(k for k in b if k not in a)]:
            yield from _differences(a.get(key), b.get(key), f"{path}.{key}" if path else key)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from _differences(x, y, f"{path}[{i}]")
    elif a != b:
        yield path, a, b


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
