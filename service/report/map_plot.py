"""Where on the whole tubesheet it was: what was seen, laid on the plant's map by the tubes' names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from service.identity.names import NamingError
from service.report.figure import WIDTH_IN, drawn

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from service.identity.counting import NamingRule
    from service.identity.maps import TubesheetMap
    from service.report.markup import Html
    from service.report.sheet import Point, Sheet

__all__ = ["map_from_sheet", "overview"]

Array: TypeAlias = "NDArray[np.float64]"
LEAST_NAMED: Final = 4
AGREES: Final = 0.25
"""Names whose places are further from one another than this part of the pitch belong to several counts."""


def map_from_sheet(sheet: Sheet, rule: NamingRule, known: TubesheetMap) -> Array | None:
    """The (3, 2) matrix of (X, Y, 1) in the sheet's plane to (x, y) on the map; None where names do not tell it."""
    places, numbers = [], []
    for place, tube in sheet.tubes.items():
        if tube.name is not None:
            try:
                name = rule.parse(tube.name)
            except NamingError:
                continue
            places.append(place)
            numbers.append((name.row, name.column))
    if len(places) < LEAST_NAMED:
        return None
    rows, columns = np.array(places).T
    x = _with_ones(rule.lattice.sheet_points(rows, columns))
    y = known.places_mm(*np.array(numbers).T)
    matrix, _, rank, _ = np.linalg.lstsq(x, y, rcond=None)
    apart = float(np.abs(x @ matrix - y).max())
    return np.asarray(matrix, np.float64) if rank == 3 and apart < AGREES * known.pitch_mm else None


def _with_ones(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])


def overview(sheet: Sheet, rule: NamingRule) -> Html | None:
    """Draw the whole map with what was seen; None without a map, or names that tell where on it."""
    known = rule.map
    matrix = None if known is None else map_from_sheet(sheet, rule, known)
    if known is None or matrix is None:
        return None
    rows, columns = (n.ravel() for n in np.mgrid[1 : known.rows + 1, 1 : known.columns + 1])
    there = known.tubes(rows, columns)
    tubes = known.places_mm(rows[there], columns[there])
    seen = _with_ones(rule.lattice.sheet_points(*np.array(list(sheet.tubes)).T)) @ matrix

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        if known.approximate:
            _hatch(ax, known)
        ax.plot(*tubes.T, ".", color="0.7", markersize=1.2, rasterized=True, label=f"tubes of the map ({len(tubes):,})")
        ax.plot(*seen.T, ".", color="0.25", markersize=1.6, rasterized=True, label="seen")
        _track(ax, sheet.camera_mm, matrix, "camera", "--")
        _track(ax, sheet.probe_mm, matrix, "where the probe would hit", "-")
        ax.set_aspect("equal")
        ax.grid(visible=False)
        ax.set_xlabel("along columns, mm")
        ax.set_ylabel("from the divider, mm")
        figure.legend(loc="outside lower center", ncols=4, frameon=False)

    approximate = "; it is APPROXIMATE, and hatched" if known.approximate else ""
    caption = f"On the map {known.name}{approximate}. Drawn as tubes are numbered, not as they are seen from the bowl."
    return drawn(f"map{sheet.number}", caption, WIDTH_IN * 0.57, draw)


def _hatch(ax: Axes, known: TubesheetMap) -> None:
    turns = np.linspace(0, np.pi, 90)
    x, y = known.outer_radius_mm * np.cos(turns), known.outer_radius_mm * np.sin(turns)
    ax.fill(x, y, facecolor="none", edgecolor="0.75", hatch="//", linewidth=0.5)


def _track(ax: Axes, points: Mapping[int, Point], matrix: Array, label: str, style: str) -> None:
    if points:
        x, y = (_with_ones(np.array([points[step] for step in sorted(points)])) @ matrix).T
        ax.plot(x, y, color="black", linestyle=style, linewidth=1.0, label=label)
        ax.plot(x[-1], y[-1], "s", color="black", markersize=3)
