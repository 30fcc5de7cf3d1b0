"""The tube lattice: where the tubes of a sheet stand, and which turns of it look alike."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Arrangement", "Lattice"]


class Arrangement(enum.StrEnum):
    """The four TEMA tube layouts: 30, 60, 90 and 45 deg."""

    TRIANGULAR = "triangular"
    ROTATED_TRIANGULAR = "rotated-triangular"
    SQUARE = "square"
    ROTATED_SQUARE = "rotated-square"

    @property
    def symmetry(self) -> int:
        """How many turns map the lattice onto itself: 6 or 4."""
        return 6 if self in (Arrangement.TRIANGULAR, Arrangement.ROTATED_TRIANGULAR) else 4


_S = math.sqrt(3) / 2
_H = math.sqrt(0.5)
_BASIS: dict[Arrangement, tuple[tuple[float, float], tuple[float, float]]] = {
    Arrangement.TRIANGULAR: ((1.0, 0.0), (0.5, _S)),
    Arrangement.ROTATED_TRIANGULAR: ((0.0, 1.0), (-_S, 0.5)),
    Arrangement.SQUARE: ((1.0, 0.0), (0.0, 1.0)),
    Arrangement.ROTATED_SQUARE: ((_H, _H), (-_H, _H)),
}


@dataclass(frozen=True, slots=True)
class Lattice:
    """The nominal tubesheet in its own plane: Z = 0 at the tube ends, X along rows, mm.

    Attributes
    ----------
    arrangement
        TEMA layout.
    pitch_mm
        Distance between neighbouring tubes' axes.
    rim_radius_mm
        Inner radius of the tube end: the edge between bright tube end and dark bore.
    outer_radius_mm
        Outer radius of the tube.
    scatter_mm
        One sigma per axis of a real tube end about its nominal place in the sheet's plane.
    height_scatter_mm
        One sigma of a real tube end's height over the nominal plane.
    pitch_sigma_mm
        One sigma of the pitch; 0 where it counts as exact.
    """

    arrangement: Arrangement
    pitch_mm: float
    rim_radius_mm: float
    outer_radius_mm: float
    scatter_mm: float = 0.05
    height_scatter_mm: float = 0.15
    pitch_sigma_mm: float = 0.0

    @property
    def basis_mm(self) -> NDArray[np.float64]:
        """Lattice vectors as rows, (2, 2) mm: row 0 is a1 (one column on), row 1 a2 (one row on)."""
        return np.array(_BASIS[self.arrangement]) * self.pitch_mm

    def sheet_points(self, rows: NDArray[np.int_], columns: NDArray[np.int_]) -> NDArray[np.float64]:
        """Nominal places of lattice sites, (n, 2) float64, (X, Y) in mm: column*a1 + row*a2."""
        return np.stack([columns, rows], axis=-1).astype(np.float64) @ self.basis_mm

    def lattice_coordinates(self, sheet_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lattice coordinates of sheet points, (n, 2) float64 (row, column), not rounded."""
        column_row = sheet_mm @ np.linalg.inv(self.basis_mm)
        return np.ascontiguousarray(column_row[..., ::-1])

    @property
    def turn_deg(self) -> float:
        """The smallest turn that maps the lattice onto itself."""
        return 360.0 / self.arrangement.symmetry

    def turned(self, turns: int) -> NDArray[np.int64]:
        """Integer matrix M, (2, 2), of `turns` lattice turns: M @ (row, column) is where that site goes to."""
        angle = math.radians(turns * self.turn_deg)
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])  # row vectors
        column_row = self.basis_mm @ turn @ np.linalg.inv(self.basis_mm)
        return np.asarray(np.rint(column_row.T[::-1, ::-1]), dtype=np.int64)
