"""What a session says, read once from its beginning to its end; what is kept does not grow with its length."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from drivers.session_index import Row
from service.report.losses import SILENT_NS, Losses
from service.report.sheet import Sheet
from service.report.timeline import Envelope, Presence, Steps

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from service.sinks.session.reader import RecordedSession, SessionCounts

__all__ = ["FIGURES", "VERDICTS", "Digest", "read_digest"]

FIGURES: Final = (
    "offset_mm", "offset_sigma_mm", "tilt_deg", "tilt_sigma_deg", "parallelism_deg", "parallelism_sigma_deg",
    "camera_tilt_deg", "camera_tilt_sigma_deg", "distance_mm", "distance_sigma_mm",
)  # fmt: skip
VERDICTS: Final = ("aligned", "adjust", "cannot judge", "no lock", "stale")
LOCKS: Final = ("full", "partial", "none")
SIGNAL: Final = ("good", "bad", "no frames")


@dataclass(slots=True, eq=False)
class Digest:
    """A session in short.

    Attributes
    ----------
    counts
        As the index says.
    steps
        Of time; None without a frame.
    figures, signal, lock, verdict
        By step; empty without a frame.
    locks, verdicts
        Pictures by lock and by verdict: an interlaced frame has two.
    losses
        What is missing.
    sheets
        One for each count of tubes: by generation, and how often an anchor began the lattice index anew.
    problems
        What could not be read, in words.
    """

    counts: SessionCounts
    steps: Steps | None
    figures: dict[str, Envelope] = field(default_factory=dict)
    signal: Presence | None = None
    lock: Presence | None = None
    verdict: Presence | None = None
    locks: Counter[str] = field(default_factory=Counter)
    verdicts: Counter[str] = field(default_factory=Counter)
    losses: Losses = field(default_factory=Losses)
    sheets: dict[tuple[int, int], Sheet] = field(default_factory=dict)
    problems: Counter[str] = field(default_factory=Counter)

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return 0.0 if self.steps is None else (self.steps.ended_ns - self.steps.began_ns) / 1e9


def read_digest(session: RecordedSession, progress: Callable[[int, int], None] = lambda _done, _total: None) -> Digest:
    """Read a session; `progress` is told how many of the measured frames are done, and how many there are."""
    counts = session.counts()
    if counts.began_ns is None or counts.ended_ns is None:
        digest = Digest(counts, None)
        for item in session.index():
            digest.losses.take(item)
        return digest
    steps = Steps.of(counts.began_ns, counts.ended_ns, counts.frames)
    digest = Digest(
        counts,
        steps,
        {name: Envelope(steps) for name in FIGURES},
        Presence(steps, SIGNAL),
        Presence(steps, LOCKS),
        Presence(steps, VERDICTS),
    )
    _read_frames(session, digest, steps)
    try:
        _read_answers(session, digest, steps, progress)
    except OSError as error:
        digest.problems[f"results.jsonl cannot be read: {error.strerror}"] += 1
    return digest


def _read_frames(session: RecordedSession, digest: Digest, steps: Steps) -> None:
    """Follow the frames: what came, what did not."""
    assert digest.signal is not None, "there are frames"
    before_ns = steps.began_ns
    for item in session.index():
        digest.losses.take(item)
        if isinstance(item, Row):
            at = steps.at(item.wall_ns)
            digest.signal.add("good" if item.defect is None else "bad", at)
            if item.wall_ns - before_ns > SILENT_NS:
                digest.signal.add("no frames", steps.at(before_ns), at)
            before_ns = item.wall_ns


def _read_answers(session: RecordedSession, digest: Digest, steps: Steps, progress: Callable[[int, int], None]) -> None:
    wall_ns, generation, anew = steps.began_ns, 1, 0
    for done, answered in enumerate(session.answers(), 1):
        if answered.row is not None:  # one that the recorder lost is as old as the one before
            wall_ns, generation = answered.row.wall_ns, answered.row.generation
        if answered.problem is not None:
            digest.problems[answered.problem] += 1
        for line in answered.lines:
            _take(digest, line, steps.at(wall_ns), wall_ns, (generation, anew))
        anew += answered.last_of_index
        progress(done, digest.counts.measured)


def _take(digest: Digest, line: Mapping[str, Any], step: int, wall_ns: int, count: tuple[int, int]) -> None:
    """Take one result line."""
    assert digest.lock is not None, "there are frames"
    assert digest.verdict is not None, "there are frames"
    digest.locks[line["lock"]] += 1
    digest.lock.add(line["lock"], step)
    pose, alignment = line["pose"], line["alignment"]
    if alignment is not None:
        digest.verdicts[alignment["verdict"]] += 1
        digest.verdict.add(alignment["verdict"], step)
    for name, value in _figures(pose, alignment).items():
        digest.figures[name].add(step, value)
    if pose is not None:
        sheet = digest.sheets.setdefault(count, Sheet(len(digest.sheets) + 1))
        sheet.add(step, wall_ns, line)


def _figures(pose: Mapping[str, Any] | None, alignment: Mapping[str, Any] | None) -> dict[str, float | None]:
    found: dict[str, float | None] = {}
    if pose is not None:
        found |= {
            "camera_tilt_deg": pose["tilt_deg"],
            "camera_tilt_sigma_deg": pose["sigma"]["tilt_deg"],
            "distance_mm": pose["distance_mm"],
            "distance_sigma_mm": pose["sigma"]["distance_mm"],
        }
    if alignment is not None:
        offset, sigma = alignment["offset_mm"], alignment["sigma_mm"]
        found |= {
            "offset_mm": None if offset is None else math.hypot(*offset),
            "offset_sigma_mm": max(sigma) if isinstance(sigma, list) else sigma,
            **{name: alignment[name] for name in FIGURES[2:6]},
        }
    return found
