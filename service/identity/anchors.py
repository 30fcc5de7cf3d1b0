"""Anchors: tubes whose names the operator knows, and the names of all others that follow from them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from service.identity.counting import Counting, NamingRule, all_countings
from service.identity.names import NamingError, TubeName

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Anchor", "NamedLattice", "check_anchors", "settle"]

CLEAR_SHARE = 1 / 3
"""The picture may be turned against the settings by this share of the lattice's smallest turn; beyond half of it the
next way to count fits better."""


@dataclass(frozen=True, slots=True)
class Anchor:
    """A lattice place, and the tube that is there.

    Attributes
    ----------
    row, column
        Lattice place.
    name
        The tube there.
    """

    row: int
    column: int
    name: TubeName

    @property
    def place(self) -> tuple[int, int]:
        """Lattice (row, column)."""
        return self.row, self.column

    def __str__(self) -> str:
        return f"{self.row},{self.column}={self.name}"


@dataclass(frozen=True, slots=True, eq=False)
class NamedLattice:
    """A lattice whose places have names.

    Attributes
    ----------
    rule, counting
        How they follow.
    anchors
        What they rest on.
    generation, index
        The lattice index that they belong to, which begins with a generation of the source: another they do not name.
    """

    rule: NamingRule
    counting: Counting
    anchors: tuple[Anchor, ...]
    generation: int
    index: int = 0

    def name_of(self, row: int, column: int) -> TubeName | None:
        """The name of a lattice place; None where the plant counts no tube (numbers below 1)."""
        return self.names_of(np.array([row]), np.array([column]))[0]

    def names_of(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> list[TubeName | None]:
        """Names of lattice places."""
        naming = self.rule.naming
        return [
            TubeName(naming, r, c) if r >= 1 and c >= 1 else None
            for r, c in self.counting.numbers(rows, columns).tolist()
        ]

    def place_of(self, name: TubeName) -> tuple[int, int]:
        """Lattice place (row, column) of a tube; raises NamingError where its numbers fall between tubes."""
        self.rule.check(name)
        place = self.counting.place(name)
        if place is None:
            raise NamingError(f"tube {name}: falls between tubes as counted from {self.anchors[0]}; check both")
        return place


def settle(
    rule: NamingRule,
    anchors: Sequence[Anchor],
    camera_from_sheet: NDArray[np.float64],
    generation: int,
    index: int = 0,
) -> NamedLattice:
    """Name the whole lattice from what is known of some places.

    One anchor settles where counting starts; which way it runs is then told by the rule's growth and by how the sheet
    lies in the picture. Two anchors settle the way too, up to the side it is seen from; three that are not in one line
    settle all. Landmarks that a picture shows are anchors like those of the operator.

    Parameters
    ----------
    anchors
        At least one.
    camera_from_sheet
        (3, 3) rotation, when the anchors were set.
    generation, index
        See `NamedLattice`.

    Raises
    ------
    NamingError
        They contradict each other or the rule, or leave more than one way.
    """
    ways = check_anchors(rule, anchors)
    if len(ways) > 1:
        ways = _upright(rule, ways, camera_from_sheet)
    if len(ways) > 1:
        raise NamingError(
            f"anchor {anchors[0]}: the picture is turned so far against [identity] rows_grow that {len(ways)} ways to"
            " count fit it; anchor another tube as well"
        )
    return NamedLattice(rule, ways[0], tuple(anchors), generation, index)


def check_anchors(rule: NamingRule, anchors: Sequence[Anchor]) -> Sequence[Counting]:
    """Ways to count that fit the anchors; raises NamingError where none does, or no picture could choose among them."""
    for anchor in anchors:
        rule.check(anchor.name)
    ways = _of_known_side(rule, anchors, _fitting(rule, anchors))
    if len(ways) > 1 and rule.mirrored is None:
        raise NamingError(
            f"anchor {anchors[0]}: {len(ways)} ways to count fit it; set [identity] rows_grow and columns_grow in the"
            " station file, or anchor two more tubes, not in one line"
        )
    return ways


def _fitting(rule: NamingRule, anchors: Sequence[Anchor]) -> Sequence[Counting]:
    """Ways to count that give every anchor its name."""
    ways = [w.through(anchors[0].place, anchors[0].name) for w in all_countings(rule)]
    ways = [w for w in ways if all(w.place(a.name) == a.place for a in anchors[1:])]
    if not ways:
        said = ", ".join(map(str, anchors))
        raise NamingError(f"anchors {said}: no way to count the tubes fits them all; one of them is another tube")
    return ways


def _of_known_side(rule: NamingRule, anchors: Sequence[Anchor], ways: Sequence[Counting]) -> Sequence[Counting]:
    """Of ways to count, those that are mirrored as the rule says, where it does."""
    sided = [w for w in ways if rule.mirrored in (None, w.mirrored)]
    if not sided:
        raise NamingError(
            f"anchors {', '.join(map(str, anchors))}: seen as mirrored, against [identity] rows_grow = "
            f'"{rule.rows_grow}", columns_grow = "{rule.columns_grow}"; is this the leg that is set?'
        )
    return sided


def _upright(rule: NamingRule, ways: Sequence[Counting], camera_from_sheet: NDArray[np.float64]) -> Sequence[Counting]:
    """Of ways seen from the same side, the one whose numbers grow in the picture as the rule says, if that is clear."""
    assert rule.rows_grow is not None, "the side is told by both"
    wanted = rule.rows_grow.direction
    off = []
    for way in ways:
        x, y = camera_from_sheet[:2, :2] @ way.growth(rule.lattice)[0]
        off.append(abs(math.degrees(math.atan2(wanted[0] * y - wanted[1] * x, wanted[0] * x + wanted[1] * y))))
    best = int(np.argmin(off))
    return [ways[best]] if off[best] <= CLEAR_SHARE * rule.lattice.turn_deg else ways
