"""How a plant counts its tubes: from lattice index to the numbers of a name, for every way the sheet may be seen.

A square lattice is counted in pitches along its two directions. The others are staggered: one number counts half
pitches along a direction, the other the rows of tubes across it, and tubes exist only where their sum has one parity.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from service.config.generators import Naming
from service.identity.names import Leg, NamingError, TubeName, parse_name
from service.vision.lattice import Arrangement, Lattice

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from service.identity.maps import TubesheetMap

__all__ = ["Counting", "Growth", "NamingRule", "all_countings", "is_staggered"]


class Growth(enum.StrEnum):
    """Where to, in the picture, a number grows."""

    RIGHT = "right"
    DOWN = "down"
    LEFT = "left"
    UP = "up"

    @property
    def direction(self) -> NDArray[np.float64]:
        """(2,) in the picture, y down."""
        return np.array({"right": (1.0, 0.0), "down": (0.0, 1.0), "left": (-1.0, 0.0), "up": (0.0, -1.0)}[self])


@dataclass(frozen=True, slots=True)
class NamingRule:
    """What the plant and the operator say about names before a picture is seen.

    Attributes
    ----------
    naming
        How a name is spelt.
    lattice
        The tubesheet.
    rows_along
        Staggered lattices: whether row numbers count half pitches along the close-packed direction (System 80), or
        across it.
    rows_grow, columns_grow
        Where to the numbers grow in the picture, as the camera stands when an anchor is set; both or neither, at a
        right angle. Their sense of turning is the handedness: the two legs mirror.
    steam_generator, leg
        For the full name.
    map
        Which tubes there are, where that is known.
    """

    naming: Naming
    lattice: Lattice
    rows_along: bool = True
    rows_grow: Growth | None = None
    columns_grow: Growth | None = None
    steam_generator: str = ""
    leg: Leg | None = None
    map: TubesheetMap | None = None

    def parse(self, text: str) -> TubeName:
        """Read the name of a tube that can exist; raises NamingError."""
        name = parse_name(text, self.naming, self.steam_generator, self.leg)
        self.check(name)
        return name

    def check(self, name: TubeName) -> None:
        """Raise NamingError where there is no such tube by the numbers alone."""
        if self.naming is Naming.LINE_ROW and is_staggered(self.lattice) and (name.row + name.column) % 2:
            raise NamingError(f"tube {name}: there is none: row + line must be even, {name.row} + {name.column} is odd")

    def full(self, name: TubeName) -> str:
        """The name with leg and steam generator."""
        return name.full(self.steam_generator, self.leg)

    @property
    def mirrored(self) -> bool | None:
        """Whether rows and columns turn in the picture against its x and y; None: not told."""
        if self.rows_grow is None or self.columns_grow is None:
            return None
        (x, y), (u, v) = self.columns_grow.direction, self.rows_grow.direction
        return bool(x * v - y * u < 0)


def is_staggered(lattice: Lattice) -> bool:
    """Whether names count half pitches: on every lattice but the square one."""
    return lattice.arrangement is not Arrangement.SQUARE


@dataclass(frozen=True, slots=True, eq=False)
class Counting:
    """One way to count: ``(row number, column number) = matrix @ (row, column) + start``.

    Attributes
    ----------
    matrix
        (2, 2) int64.
    start
        (2,) int64: the numbers of lattice place (0, 0); known once a tube is.
    mirrored
        See `NamingRule.mirrored`.
    """

    matrix: NDArray[np.int64]
    start: NDArray[np.int64]
    mirrored: bool

    def numbers(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> NDArray[np.int64]:
        """Numbers of lattice places, (n, 2): row and column as the plant counts."""
        return np.stack([rows, columns], axis=-1).astype(np.int64) @ self.matrix.T + self.start

    def place(self, name: TubeName) -> tuple[int, int] | None:
        """Lattice place (row, column) of a name; None where its numbers fall between tubes."""
        (a, b), (c, d) = self.matrix.tolist()
        u, v = (np.array([name.row, name.column]) - self.start).tolist()
        det = a * d - b * c
        row, column = d * u - b * v, a * v - c * u
        return None if row % det or column % det else (row // det, column // det)

    def through(self, place: tuple[int, int], name: TubeName) -> Counting:
        """The same way to count, begun so that `place` has this name."""
        start = np.array([name.row, name.column], np.int64) - self.matrix @ np.array(place, np.int64)
        return Counting(self.matrix, start, self.mirrored)

    def growth(self, lattice: Lattice) -> NDArray[np.float64]:
        """Unit vectors in the sheet's plane, (2, 2): along which the row number grows, and the column number."""
        lattice_from_sheet = np.linalg.inv(lattice.basis_mm).T[::-1]  # (row, column) of (X, Y)
        gradient = self.matrix @ lattice_from_sheet
        return np.asarray(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))


def all_countings(rule: NamingRule) -> Sequence[Counting]:
    """Every way in which the plant's counting may lie over the lattice: each turn of it, seen from either side."""
    lattice, zero = rule.lattice, np.zeros(2, np.int64)
    along_across = np.array(_ALONG_ACROSS[lattice.arrangement], np.int64)
    order = (0, 1) if rule.rows_along else (1, 0)
    found = []
    for turns in range(lattice.arrangement.symmetry):
        for side in (1, -1):
            matrix = (np.diag([1, side]) @ along_across @ lattice.turned(turns))[list(order)]
            found.append(Counting(matrix, zero, bool(np.linalg.det(matrix) < 0)))
    return found


_ALONG_ACROSS = {
    Arrangement.TRIANGULAR: ((1, 2), (1, 0)),
    Arrangement.ROTATED_TRIANGULAR: ((1, 2), (1, 0)),
    Arrangement.SQUARE: ((0, 1), (1, 0)),
    Arrangement.ROTATED_SQUARE: ((-1, 1), (1, 1)),
}
"""Counts along and across the rows of tubes, of lattice (row, column)."""
