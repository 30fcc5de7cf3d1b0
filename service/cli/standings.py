"""Which tube the guide stands over in each picture, for `align-setup`."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.errors import CalibrationError, ConfigError
from service.alignment.geometry import tube_end
from service.alignment.setup import Standing
from service.alignment.targets import nearest_place
from service.cli.terminal import say
from service.vision.measurement import Doubt
from service.vision.projection import undistort

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from service.alignment.geometry import TubeEnd
    from service.config.standings import TableLine
    from service.identity.anchors import NamedLattice
    from service.identity.namer import TubeNamer
    from service.results import FrameResult
    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement, Pose

__all__ = ["StandingOver"]


@dataclass(slots=True)
class _Group:
    """What was seen of one standing."""

    label: str
    views: list[tuple[Pose, TubeEnd]]
    inserted_mm: float | None


class StandingOver:
    """Sorts pictures by the tube that the guide stands over.

    With a table, a line of it is a standing. Without, each picture of a folder is one, and of a video as many in a row
    as show the same tube.
    """

    def __init__(
        self,
        lattice: Lattice,
        guide_px: tuple[float, float] | None,
        lines: Sequence[TableLine] | None,
        namer: TubeNamer,
        *,
        apart: bool,
    ) -> None:
        self._apart = apart
        self._lattice, self._guide_px, self._lines, self._namer = lattice, guide_px, lines, namer
        self._groups: dict[object, _Group] = {}
        self._last: tuple[int, tuple[int, int]] | None = None
        self._skipped: dict[str, int] = defaultdict(int)

    def take(self, result: FrameResult) -> None:
        """Take one picture in, where it says something."""
        m = result.measurement
        named = self._namer.update(m, result.generation)
        line = next((t for t in self._lines or () if t.first <= result.sequence <= t.last), None)
        if line is None and self._lines is not None:
            return
        if m.pose is None:
            self._skipped[f"no lock: {m.reason}"] += 1
            return
        place = self._place(m, m.pose, line, named)
        if place is not None:
            self._group(result, place, line).views.append((m.pose, tube_end(m, place, self._lattice)))
            self._last = result.sequence, place

    def _group(self, result: FrameResult, place: tuple[int, int], line: TableLine | None) -> _Group:
        """The standing that a picture belongs to."""
        if line is not None:
            return self._groups.setdefault(line, _Group(f"{line}, tube {line.target}", [], line.inserted_mm))
        if self._last is None or (result.sequence != self._last[0] if self._apart else place != self._last[1]):
            tube = f"tube {place[0]},{place[1]}"
            self._groups[len(self._groups)] = _Group(f"frame {result.sequence}, {tube}", [], None)
        return self._groups[len(self._groups) - 1]

    def _place(
        self, m: Measurement, pose: Pose, line: TableLine | None, named: NamedLattice | None
    ) -> tuple[int, int] | None:
        """The lattice place of the tube; None, and noted, where this picture does not tell it."""
        if line is not None and str(line.target) != "nearest":
            if Doubt.INDEX in m.doubt:
                self._skipped["the lattice index is in doubt"] += 1
                return None
            return line.target.place or self._place_named(line, named)
        assert self._guide_px is not None, "checked before anything was measured"
        foot = _on_sheet(pose, self._guide_px)
        if foot is None:
            self._skipped["the sheet is not where --guide-px points"] += 1
            return None
        return nearest_place(foot, self._lattice, m.tubes)

    def _place_named(self, line: TableLine, named: NamedLattice | None) -> tuple[int, int]:
        name = line.target.name
        assert name is not None, "neither a place nor the nearest"
        if named is None:
            raise ConfigError(f"{line}: tube {name}: {self._namer.problem or 'no anchor names it; give --anchor'}")
        return named.place_of(name)

    def standings(self, inserted_mm: float) -> Sequence[Standing]:
        """All standings; raises CalibrationError where there is none, or a line of the table has no picture."""
        for reason, count in self._skipped.items():
            say(f"{count} picture{'s' * (count != 1)} left out: {reason}")
        if self._lines is not None and (missing := [line for line in self._lines if line not in self._groups]):
            raise CalibrationError(f"{missing[0]}: no picture with a lock there; correct the table, or leave it out")
        return [
            Standing(g.label, g.views, inserted_mm if g.inserted_mm is None else g.inserted_mm)
            for g in self._groups.values()
        ]


def _on_sheet(pose: Pose, point_px: tuple[float, float]) -> NDArray[np.float64] | None:
    """The sheet point (2,) mm that a picture point shows; None where it shows none."""
    ray = pose.rotation.T @ np.append(undistort(pose.camera.vector(), np.array([point_px]))[0], 1.0)
    center = -pose.rotation.T @ pose.translation_mm
    if not ray[2] > 0:  # NaN, too
        return None
    return np.asarray(center[:2] - ray[:2] * (center[2] / ray[2]))
