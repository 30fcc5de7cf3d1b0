"""The tubesheet from below as far as it was seen, to scale, and where camera and probe were."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.collections import EllipseCollection

from service.report.figure import WIDTH_IN, drawn

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from service.report.markup import Html
    from service.report.sheet import Point, Sheet
    from service.vision.lattice import Lattice

__all__ = ["plan"]

MOST_DRAWN: Final = 2500
"""More tubes are drawn as a picture: as lines they would make the file large."""
MOST_NAMES: Final = 12
NEAR_MM: Final = 30.0
LOOKS: Final = {
    "open": {"facecolor": "white", "edgecolor": "0.25", "linewidth": 0.5},
    "unknown": {"facecolor": "0.95", "edgecolor": "0.5", "linewidth": 0.5},
    "plugged": {"facecolor": "0.6", "edgecolor": "black", "linewidth": 0.6, "hatch": "xxxxxx"},
    "absent": {"facecolor": "none", "edgecolor": "0.6", "linewidth": 0.4, "linestyle": ":"},
    "inferred": {"facecolor": "none", "edgecolor": "0.75", "linewidth": 0.4, "linestyle": "--"},
}


def plan(sheet: Sheet, lattice: Lattice) -> Html:
    """Draw one count of tubes."""
    places = np.array(list(sheet.tubes) or np.zeros((0, 2)), np.int64)
    points = lattice.sheet_points(places[:, 0], places[:, 1])

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        _tubes(ax, sheet, points, lattice)
        _tracks(ax, sheet)
        _names(ax, sheet, lattice)
        ax.set_aspect("equal")
        ax.set_xlim(*_around(points[:, 0], [x for x, _ in _drawn_points(sheet)]))
        ax.set_ylim(*_around(points[:, 1], [y for _, y in _drawn_points(sheet)])[::-1])
        ax.set_xlabel("X of the sheet, mm")
        ax.set_ylabel("Y, mm")
        ax.grid(visible=False)
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=4, frameon=False)

    return drawn(f"plan{sheet.generation}", _caption(sheet), WIDTH_IN * 0.95, draw)


def _drawn_points(sheet: Sheet) -> list[Point]:
    return [*sheet.camera_mm.values(), *sheet.seen_mm.values(), *sheet.probe_mm.values()]


def _around(tubes: NDArray[np.float64], tracks: list[float]) -> tuple[float, float]:
    """Limits of the drawing: all tubes, and tracks as far as they are not beside the sheet by far."""
    if not len(tubes):
        return (min(tracks) - NEAR_MM, max(tracks) + NEAR_MM) if tracks else (-NEAR_MM, NEAR_MM)
    low, high = float(tubes.min()), float(tubes.max())
    reach = (high - low) / 2 + NEAR_MM
    near = [t for t in tracks if low - reach <= t <= high + reach]
    return min([low, *near]) - NEAR_MM, max([high, *near]) + NEAR_MM


def _tubes(ax: Axes, sheet: Sheet, points: NDArray[np.float64], lattice: Lattice) -> None:
    states = np.array([state for state, _ in sheet.tubes.values()], object)
    size = np.full(len(points), 2 * lattice.outer_radius_mm)
    for state, look in LOOKS.items():
        of = states == state
        if of.any():
            circles = EllipseCollection(
                size[of], size[of], np.zeros(of.sum()), units="xy", offsets=points[of], transOffset=ax.transData, **look
            )
            circles.set_rasterized(len(points) > MOST_DRAWN)
            ax.add_collection(circles)
            ax.plot([], [], "o", markersize=6, markerfacecolor=look["facecolor"], markeredgecolor=look["edgecolor"],
                    label=f"{state} ({of.sum()})")  # fmt: skip


def _tracks(ax: Axes, sheet: Sheet) -> None:
    _track(ax, sheet.camera_mm, "camera, over the sheet", "black", "--")
    _track(ax, sheet.seen_mm, "middle of the picture's axis", "0.45", ":")
    if sheet.probe_mm:
        x, y = np.array([sheet.probe_mm[step] for step in sorted(sheet.probe_mm)]).T
        ax.plot(x, y, "+", color="black", markersize=4, markeredgewidth=0.6, label="where the probe would hit")


def _track(ax: Axes, points: Mapping[int, Point], label: str, grey: str, style: str) -> None:
    if points:
        x, y = np.array([points[step] for step in sorted(points)]).T
        ax.plot(x, y, color=grey, linestyle=style, linewidth=1.0, label=label)
        ax.plot(x[0], y[0], "o", color=grey, markersize=5, markerfacecolor="white")
        ax.plot(x[-1], y[-1], "s", color=grey, markersize=5)


def _names(ax: Axes, sheet: Sheet, lattice: Lattice) -> None:
    """Name the tubes that the guide was at most."""
    longest = sorted(sheet.visits.items(), key=lambda item: -item[1].verdicts.total())[:MOST_NAMES]
    for (row, column), visit in longest:
        at = lattice.sheet_points(np.array([row]), np.array([column]))[0]
        ax.annotate(visit.tube, (at[0], at[1]), fontsize=6, ha="center", va="center",
                    bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6})  # fmt: skip


def _caption(sheet: Sheet) -> str:
    return (
        f"From {sheet.pictures:,} pictures with a pose, as seen from the bowl: X to the right, Y down, as the first"
        " picture laid them. A ring is where a track begins, a square where it ends. Crossed: plugged. Broken: never"
        " measured, predicted from the others."
    )
