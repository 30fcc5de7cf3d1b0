"""What was seen of the tubesheet, and where camera and probe were before it; one sheet for each count of tubes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np

__all__ = ["MOST_TUBES", "Sheet", "Tube", "Visit", "look"]

MOST_TUBES: Final = 20_000
Point: TypeAlias = tuple[float, float]
Line: TypeAlias = Mapping[str, Any]


@dataclass(slots=True)
class Visit:
    """A tube that the guide stood before.

    Attributes
    ----------
    tube
        Its name; its lattice place where it has none.
    first_ns, last_ns
        UTC.
    verdicts
        How often each.
    best_mm, best_sigma_mm
        The smallest offset, and its sigma.
    """

    tube: str
    first_ns: int
    last_ns: int
    verdicts: Counter[str] = field(default_factory=Counter)
    best_mm: float | None = None
    best_sigma_mm: float | None = None

    def add(self, wall_ns: int, alignment: Line) -> None:
        """Take a picture of it."""
        self.last_ns = wall_ns
        self.verdicts[str(alignment["verdict"])] += 1
        offset = alignment["offset_mm"]
        if offset is not None and (self.best_mm is None or np.hypot(*offset) < self.best_mm):
            self.best_mm, self.best_sigma_mm = float(np.hypot(*offset)), _larger(alignment["sigma_mm"])


def _larger(sigmas: list[float] | float | None) -> float | None:
    return None if sigmas is None else float(np.max(sigmas))


@dataclass(slots=True)
class Tube:
    """What was seen of a tube: its name, and how often in which state."""

    name: str | None = None
    states: Counter[str] = field(default_factory=Counter)

    @property
    def state(self) -> str:
        """As most pictures have it; "predicted" where none showed it."""
        return max(self.states, key=lambda state: self.states[state], default="predicted")


@dataclass(slots=True)
class Sheet:
    """The sheet as one count of tubes has it: reopening the source begins another, and so may an anchor.

    Attributes
    ----------
    number
        From 1 on, in the order of time.
    tubes
        By lattice place (row, column).
    camera_mm, seen_mm, probe_mm
        By step of time, in the sheet's plane: foot of the perpendicular from the camera, where its axis meets the
        sheet, where the probe would hit.
    visits
        By place.
    pictures
        With a pose.
    """

    number: int
    tubes: dict[tuple[int, int], Tube] = field(default_factory=dict)
    camera_mm: dict[int, Point] = field(default_factory=dict)
    seen_mm: dict[int, Point] = field(default_factory=dict)
    probe_mm: dict[int, Point] = field(default_factory=dict)
    visits: dict[tuple[int, int], Visit] = field(default_factory=dict)
    pictures: int = 0

    def add(self, step: int, wall_ns: int, line: Line) -> None:
        """Take a result line with a pose."""
        self.pictures += 1
        self.camera_mm[step], seen = look(line["pose"])
        if seen is not None:
            self.seen_mm[step] = seen
        if "index" in line["doubt"]:
            return  # its rows and columns may be those of other tubes
        for tube in line["tubes"]:
            self._tube(tube)
        alignment = line["alignment"]
        if alignment is not None and alignment["place"] is not None:
            self._visit(wall_ns, alignment)
            if alignment["entry"] is not None:
                self.probe_mm[step] = tuple(alignment["entry"]["center_mm"])

    def _tube(self, tube: Line) -> None:
        place = tube["row"], tube["column"]
        known = self.tubes.get(place)
        if known is None:
            if len(self.tubes) >= MOST_TUBES:
                return
            known = self.tubes[place] = Tube()
        known.name = tube["name"] or known.name
        if tube["state"] != "unknown" or tube["origin"] == "measured":
            known.states[tube["state"]] += 1

    def _visit(self, wall_ns: int, alignment: Line) -> None:
        place = tuple(alignment["place"])
        visit = self.visits.get(place)
        if visit is None:
            if len(self.visits) >= MOST_TUBES:
                return
            visit = self.visits[place] = Visit("", wall_ns, wall_ns)
        known = self.tubes.get(place)
        visit.tube = (known and known.name) or f"place {place[0]}, {place[1]}"
        visit.add(wall_ns, alignment)


def look(pose: Line) -> tuple[Point, Point | None]:
    """Foot of the perpendicular from the camera to the sheet, and where its axis meets the sheet, (X, Y) in mm each."""
    rotation, translation = np.array(pose["rotation"]), np.array(pose["translation_mm"])
    center, axis = -rotation.T @ translation, rotation[2]
    foot = float(center[0]), float(center[1])
    if abs(axis[2]) < 0.1:
        return foot, None
    x, y, _ = center - center[2] / axis[2] * axis
    return foot, (float(x), float(y))
