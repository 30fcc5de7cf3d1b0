"""Bowlsight beside OpenCV's finders: time, tubes found, error, on the same pictures in the same minutes."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.scene import CLEAN, HARD
from service.vision.measurement import Lock, Measurement
from tests.bench.bowlsight import Acquired, Tracked, measured_px
from tests.bench.peers import peers_for
from tests.bench.pictures import Take, Truth, card, rendered, stills
from tests.bench.tables import table
from tests.bench.timing import Times, interleaved

GRADES = ("clean", "nominal", "dim", "hard", "brutal")
HEADS = ("pictures", "method", "median ms", "p99 ms", "times as long", "found %", "false", "error px")


@dataclass(frozen=True)
class Score:
    """One picture's: share of the open, wholly seen tubes that are found; finds where none is; squared errors."""

    found: float
    false: int
    squares: np.ndarray


def score(center_px: np.ndarray, truth: Truth, pitch_px: float) -> Score:
    """Hold what was found against the truth: a find belongs to a tube that is nearer than a quarter pitch."""
    if not len(center_px):
        return Score(0.0, 0, np.zeros(0))
    off = np.linalg.norm(center_px[:, None] - truth.center_px[None], axis=2)
    nearest = off.argmin(axis=1)
    near = off[np.arange(len(off)), nearest] < 0.25 * pitch_px
    good = near & truth.open[nearest]
    error = center_px[good] - truth.center_px[nearest[good]]
    return Score(len(set(nearest[good])) / max(1, truth.open.sum()), int((~near).sum()), (error**2).mean(axis=1))


def side_by_side(shared: Path | None, *, quick: bool) -> str:
    """Measure and give the table."""
    rows = []
    for take in _takes(quick=quick):
        rows += _rows(_title(take), [_times(take, quick=quick)])
    by_grade: dict[str, list[Take]] = {}
    for take in stills(shared / "bowl" / "stills") if shared else []:
        by_grade.setdefault(take.name, []).append(take)
    for grade in GRADES[1:2] if quick else GRADES:
        takes = by_grade.get(grade, [])[: 1 if quick else None]
        if not takes:
            continue
        title = f"ray-traced stills, {grade} ({len(takes)})"
        rows += _rows(title, [_times(take, quick=quick, still=True) for take in takes])
    return table(HEADS, rows)


def _takes(*, quick: bool) -> list[Take]:
    vga, hd = (640, 480), (1920, 1080)
    if quick:
        return [card(2), rendered("nominal 640x480", vga, 100, count=3)]
    return [
        card(),
        rendered("clean, square 640x480", vga, 100, look=CLEAN, generator="model-f"),
        rendered("nominal 640x480", vga, 100),
        rendered("hard 640x480", vga, 100, look=HARD),
        rendered("nominal 1920x1080", hd, 350),
    ]


def _title(take: Take) -> str:
    return f"{take.name}, {take.tubes} tubes"


def _times(take: Take, *, quick: bool, still: bool = False) -> tuple[Take, dict[str, Times]]:
    # a still gives no hint of its scan: brutal ones may be two fields, told apart at the price of measuring three times
    field = "unknown" if still and take.name == "brutal" else "progressive"
    calls: dict[str, Callable[[int], Any]] = {
        "**Bowlsight, tracked**": Tracked(take, field),
        "**Bowlsight, from nothing**": Acquired(take, field),
    }
    calls |= {name: _on_pictures(peer, take) for name, peer in peers_for(take).items()}
    rounds, budget_s = (2, 0.2) if quick else (6, 1.0) if still else (120, 6.0)
    return take, interleaved(calls, take.there_and_back(), rounds=rounds, budget_s=budget_s)


def _on_pictures(peer: Callable[[np.ndarray], np.ndarray], take: Take) -> Callable[[int], np.ndarray]:
    return lambda number: peer(take.pictures[number])


def _rows(title: str, timed: list[tuple[Take, dict[str, Times]]]) -> list[list[object]]:
    """A row a method: medians over calls, and over takes where there are several."""
    rows = []
    for name in timed[0][1]:
        scores = [_scored(take, times[name]) for take, times in timed]
        found, false = np.mean([s.found for s in scores]), np.mean([s.false for s in scores])
        errors = [float(np.sqrt(s.squares.mean())) for s in scores if s.squares.size]
        rows.append([
            title, name, _over(timed, name, "median"), max(times[name].p99 for _, times in timed),
            float(np.median([times[name].median / times["**Bowlsight, tracked**"].median for _, times in timed])),
            100 * float(found), float(false), float(np.median(errors)) if errors else None,
        ])  # fmt: skip
        title = ""
    return rows


def _over(timed: list[tuple[Take, dict[str, Times]]], name: str, what: str) -> float:
    return float(np.median([getattr(times[name], what) for _, times in timed]))


def _scored(take: Take, times: Times) -> Score:
    """All of a take's pictures as one."""
    each = [score(_centers(result), take.truth[number], take.pitch_px) for number, result in times.results]
    return Score(
        float(np.mean([s.found for s in each])), float(np.mean([s.false for s in each])),
        np.concatenate([s.squares for s in each]),
    )  # fmt: skip


def _centers(result: Measurement | np.ndarray) -> np.ndarray:
    if not isinstance(result, Measurement):
        return result
    return np.zeros((0, 2)) if result.lock is Lock.NONE else measured_px(result)
