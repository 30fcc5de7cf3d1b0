"""Bowlsight by itself: cost per stage, growth with tubes and pixels, what radiation specks cost in accuracy."""

import itertools
from dataclasses import replace

import numpy as np

from drivers.scene import NOMINAL
from service.vision.measurement import Lock
from tests.bench.bowlsight import Acquired, Tracked, measured_px
from tests.bench.pictures import Take, rendered
from tests.bench.side_by_side import score
from tests.bench.tables import table
from tests.bench.timing import Times, interleaved

VGA, HD = (640, 480), (1920, 1080)
BUFFERS = 4
LIT = replace(NOMINAL, wall=0.05)
"""Bores lit so little that their walls do not hide what specks cost."""


def _by_itself(takes: dict[str, Take], kind: type[Tracked], *, quick: bool) -> dict[str, Times]:
    """Times of one take after the other: a service has one camera, and its code and memory at hand."""
    return {name: _in_turns({name: take}, kind, quick=quick)[name] for name, take in takes.items()}


def _in_turns(takes: dict[str, Take], kind: type[Tracked], *, quick: bool) -> dict[str, Times]:
    """Times of every take, in turns; each goes its own way there and back, as a grabber hands it on."""
    grabbers = {name: Grabber(take) for name, take in takes.items()}
    calls = {name: kind(take).measure for name, take in takes.items()}
    rounds = 4 if quick else 300 if kind is Tracked else 60
    return interleaved(
        calls, range(10**6), rounds=rounds, budget_s=30.0, skip=2 if quick else 20,
        handed=lambda name, _: grabbers[name].grab(),
    )  # fmt: skip


class Grabber:
    """Hands on the pictures of a take as grabbers do: each has just been written into one of a few buffers."""

    def __init__(self, take: Take) -> None:
        self._pictures, self._way = take.pictures, take.there_and_back()
        self._buffers = itertools.cycle([np.empty_like(take.pictures[0]) for _ in range(BUFFERS)])

    def grab(self) -> np.ndarray:
        buffer = next(self._buffers)
        np.copyto(buffer, self._pictures[next(self._way)])
        return buffer


def stages(*, quick: bool) -> str:
    """What each stage takes: of a camera that stands, and of one that pans to and fro and speeds up all the time."""
    takes = {
        "640x480, 100 tubes": rendered("", VGA, 100, count=4 if quick else 24),
        "640x480, 100 tubes, standing": rendered("", VGA, 100, count=1),
    }
    if not quick:
        takes["1920x1080, 350 tubes"] = rendered("", HD, 350)
        takes["1920x1080, 350 tubes, standing"] = rendered("", HD, 350, count=1)
    rows = []
    for mode, kind in (("tracked", Tracked), ("from nothing", Acquired)):
        shown = {name: take for name, take in takes.items() if kind is Tracked or "standing" not in name}
        for name, times in _by_itself(shown, kind, quick=quick).items():
            parts = [m.elapsed_ms for _, m in times.results]
            laps = [float(np.median([p.get(stage, 0.0) for p in parts])) for stage in ("detect", "lattice", "pose")]
            rows.append([f"{name}, {mode}", *laps, times.median, times.p99, times.p99 / times.median])
    heads = ("", "find and measure ms", "lattice ms", "pose and sigmas ms", "all ms", "p99 ms", "p99 / median")
    return table(heads, rows)


def growth(*, quick: bool) -> str:
    """How the time of a tracked picture grows with tubes at equal pixels, and with pixels at equal tubes."""
    count = 3 if quick else 24
    tubes = (50, 100) if quick else (50, 100, 200, 400, 800)
    sizes = ((320, 240), VGA) if quick else (VGA, (1280, 960), HD, (3840, 2160))
    with_tubes = {f"1280x960, {n} tubes": rendered("", (1280, 960), n, count=count) for n in tubes}
    standing = {f"{w}x{h}, 100 tubes, standing": rendered("", (w, h), 100, count=1) for w, h in sizes}
    moving = {f"{w}x{h}, 100 tubes": rendered("", (w, h), 100, count=count) for w, h in sizes[:3]}
    rows = []
    for takes in (with_tubes, standing, moving):
        times = _in_turns(takes, Tracked, quick=quick)
        first = next(iter(times.values())).median
        rows += [[name, takes[name].tubes, t.median, t.p99, t.median / first] for name, t in times.items()]
    return table(("", "tubes in view", "median ms", "p99 ms", "of the first"), rows)


def specks(*, quick: bool) -> str:
    """Errors with and without radiation specks, on pictures that are the same in all else."""
    count, densities = (2, (0, 300)) if quick else (40, (0, 100, 300, 600, 1000))
    rows, plain = [], None
    for density in densities:
        take = rendered("", VGA, 100, count=count, look=replace(LIT, specks=float(density)))
        errors = _errors(take)
        plain = errors if plain is None else plain
        rows.append([f"{density} specks a picture", *errors, errors[0] / plain[0]])
    heads = ("640x480, 100 tubes, tracked", "tubes px", "distance mm", "tilt deg", "locked %", "tubes: of none")
    return table(heads, rows)


def _errors(take: Take) -> tuple[float, float, float, float]:
    """Rms of the measured tubes' centres, of distance and of tilt, and the share of pictures locked."""
    tracked = Tracked(take)
    squares, distance, tilt, locked = [], [], [], 0
    for number, truth in enumerate(take.truth):
        m = tracked(number)
        if m.lock is Lock.NONE:
            continue
        locked += 1
        squares.append(score(measured_px(m), truth, take.pitch_px).squares)
        distance.append(m.pose.distance_mm - truth.rotation[:, 2] @ truth.translation_mm)
        tilt.append(m.pose.tilt_deg - np.degrees(np.arccos(min(1.0, truth.rotation[2, 2]))))
    rms = [float(np.sqrt(np.mean(np.square(v)))) for v in (distance, tilt)]
    return float(np.sqrt(np.concatenate(squares).mean())), *rms, 100 * locked / len(take.truth)
