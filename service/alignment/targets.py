"""Which tube is meant: the one named, the one at a lattice place, or the one nearest to the guide's axis."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from service.identity.anchors import Anchor
from service.identity.names import NamingError, TubeName
from service.vision.measurement import TubeState

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.identity.counting import NamingRule
    from service.vision.lattice import Lattice
    from service.vision.measurement import Tubes

__all__ = ["NEAREST", "Target", "nearest_place", "parse_anchor", "parse_target", "state_at"]

_AROUND = np.array(list(itertools.product(range(-1, 3), repeat=2)))
"""Lattice steps from a cell's corner among which the nearest place is, in every arrangement."""
_PLACE = re.compile(r" *(-?[0-9]{1,4}) *, *(-?[0-9]{1,4}) *")


@dataclass(frozen=True, slots=True)
class Target:
    """The tube to be aligned to; the nearest one where neither name nor place is given.

    Attributes
    ----------
    name
        By its name: holds as long as an anchor names tubes.
    place
        By its lattice (row, column): holds as long as that index does.
    generation, index
        Of the source, and of the lattice index in it, that `place` belongs to; None: the first there is.
    """

    name: TubeName | None = None
    place: tuple[int, int] | None = None
    generation: int | None = None
    index: int | None = None

    def continues(self, before: Target) -> bool:
        """Whether it is what it was before, at most bound to its lattice index since."""
        generation = None if before.generation is None else self.generation
        index = None if before.index is None else self.index
        return replace(self, generation=generation, index=index) == before

    def bound(self, generation: int, index: int) -> Target:
        """A place that belongs to the first index there is, where that is this one."""
        if self.place is None or None not in (self.generation, self.index):
            return self
        known = generation if self.generation is None else self.generation
        return replace(self, generation=known, index=index if self.index is None else self.index)

    def to_dict(self) -> dict[str, Any]:
        """In JSON's own types."""
        place = None if self.place is None else list(self.place)
        name = None if self.name is None else str(self.name)
        return {"name": name, "place": place, "generation": self.generation, "index": self.index}

    def __str__(self) -> str:
        if self.place is not None:
            return f"{self.place[0]},{self.place[1]}"
        return "nearest" if self.name is None else str(self.name)


NEAREST = Target()


def parse_target(text: str, rule: NamingRule) -> Target:
    """Read "nearest", a lattice place "ROW,COLUMN", or a tube's name; raises NamingError."""
    if text.strip().lower() == "nearest":
        return NEAREST
    if match := _PLACE.fullmatch(text):
        return Target(place=(int(match[1]), int(match[2])))
    return Target(name=rule.parse(text))


def parse_anchor(text: str, rule: NamingRule) -> Anchor:
    """Read "ROW,COLUMN=NAME": the tube at this lattice place has that name; raises NamingError."""
    place, equals, name = text.partition("=")
    match = _PLACE.fullmatch(place)
    if match is None or not equals:
        raise NamingError(
            f"anchor {text!r}: must be ROW,COLUMN=NAME, with the lattice row and column that results show"
        )
    return Anchor(int(match[1]), int(match[2]), rule.parse(name))


def state_at(tubes: Tubes, place: tuple[int, int]) -> TubeState:
    """What stands at a lattice place; UNKNOWN where the picture does not show it."""
    at = np.flatnonzero((tubes.row == place[0]) & (tubes.column == place[1]))
    return TubeState(int(tubes.state[at[0]])) if len(at) else TubeState.UNKNOWN


def nearest_place(foot_mm: NDArray[np.float64], lattice: Lattice, tubes: Tubes) -> tuple[int, int]:
    """Lattice place of the tube nearest to a sheet point; places seen to have none are passed over."""
    corner = np.floor(lattice.lattice_coordinates(foot_mm[None])[0]).astype(int)
    near = _AROUND + corner
    away = np.linalg.norm(lattice.sheet_points(near[:, 0], near[:, 1]) - foot_mm, axis=1)
    places = [(int(row), int(column)) for row, column in near[np.argsort(away, kind="stable")]]
    return next((p for p in places if state_at(tubes, p) is not TubeState.ABSENT), places[0])
