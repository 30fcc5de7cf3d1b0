"""Tubesheet maps: which tubes there are. Those made from published dimensions alone are approximate, and marked so."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.errors import ConfigError
from service.config.shipped import shipped_config
from service.config.table import read_toml
from service.vision.lattice import Arrangement

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.identity.names import TubeName

__all__ = ["MAPS", "TubesheetMap", "load_map"]

MAPS = ("model-f", "51b", "system80")
"""What is shipped, in `config/tubesheets`."""
STEPS = {
    Arrangement.SQUARE: (1.0, 1.0),
    Arrangement.TRIANGULAR: (np.sqrt(0.75), 0.5),
}
"""Steps from column (line) to column and from row to row, in pitches; triangular as System 80 counts."""

ON_THE_EDGE_MM = 0.001
"""A tube exactly on a circle is in, on both sides of the sheet, however its place is rounded."""


@dataclass(frozen=True, slots=True)
class TubesheetMap:
    """Half a round tubesheet: numbers, and the circles between which they are tubes.

    Attributes
    ----------
    name, approximate
        Where it comes from, and whether it stands for the plant's own.
    arrangement, pitch_mm
        Square, or triangular with rows counted in half pitches and tubes where row + column is even.
    rows, columns
        How many of each are counted; columns (lines) lie about the middle.
    first_row_mm
        Distance of row 1 from the divider's middle.
    inner_radius_mm, outer_radius_mm
        Tubes lie between; the inner one is the stay cylinder's.
    """

    name: str
    approximate: bool
    arrangement: Arrangement
    pitch_mm: float
    rows: int
    columns: int
    first_row_mm: float
    inner_radius_mm: float
    outer_radius_mm: float

    def holds(self, name: TubeName) -> bool:
        """Whether there is such a tube, as far as this map knows."""
        return bool(self.tubes(np.array([name.row]), np.array([name.column]))[0])

    def places_mm(self, rows: NDArray[np.int_], columns: NDArray[np.int_]) -> NDArray[np.float64]:
        """Where the plant's numbers are, (..., 2): x along columns from the middle, y from the divider's middle."""
        across, up = STEPS[self.arrangement]
        x = (columns - (self.columns + 1) / 2) * across * self.pitch_mm
        y = self.first_row_mm + (rows - 1) * up * self.pitch_mm
        return np.stack(np.broadcast_arrays(x, y), axis=-1)

    def tubes(self, rows: NDArray[np.int_], columns: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Whether there are such tubes, by the plant's numbers."""
        r = np.hypot(*np.moveaxis(self.places_mm(rows, columns), -1, 0))
        counted = (rows >= 1) & (rows <= self.rows) & (columns >= 1) & (columns <= self.columns)
        if self.arrangement is Arrangement.TRIANGULAR:
            counted = counted & ((rows + columns) % 2 == 0)
        return np.asarray(
            counted & (r >= self.inner_radius_mm - ON_THE_EDGE_MM) & (r <= self.outer_radius_mm + ON_THE_EDGE_MM)
        )

    def count(self) -> int:
        """How many tubes it has."""
        rows, columns = np.mgrid[1 : self.rows + 1, 1 : self.columns + 1]
        return int(self.tubes(rows, columns).sum())


def load_map(name: str) -> TubesheetMap:
    """Read a map: a shipped one by its name, or a .toml file; raises ConfigError where it is not sound."""
    if not name.endswith(".toml"):
        if name not in MAPS:
            near = difflib.get_close_matches(name, MAPS, 1, 0.4)
            hint = f"did you mean {near[0]}? " if near else ""
            raise ConfigError(f"tubesheet map {name!r}: unknown; {hint}known: {', '.join(MAPS)}, or a .toml file")
        return _read(shipped_config(f"tubesheets/{name}.toml"))
    return _read(Path(name))


def _read(path: Path) -> TubesheetMap:
    t = read_toml(path)
    arrangement = t.choice("arrangement", Arrangement)
    if arrangement not in STEPS:
        raise t.error("arrangement", f"must be {' or '.join(STEPS)}: others have no rule of counting yet")
    outer = t.number("outer_radius_mm", above=0)
    found = TubesheetMap(
        name=path.stem,
        approximate=t.flag("approximate"),
        arrangement=arrangement,
        pitch_mm=t.number("pitch_mm", above=0),
        rows=t.integer("rows", minimum=1, maximum=999),
        columns=t.integer("columns", minimum=1, maximum=999),
        first_row_mm=t.number("first_row_mm", minimum=0),
        inner_radius_mm=t.number("inner_radius_mm", 0.0, minimum=0, maximum=outer),
        outer_radius_mm=outer,
    )
    t.finish()
    return found
