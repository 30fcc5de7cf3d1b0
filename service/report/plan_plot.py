"""The tubesheet from below as far as it was seen, to scale, and where camera and probe were."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
from matplotlib.collections import EllipseCollection
from matplotlib.patheffects import Normal, Stroke

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

Points: TypeAlias = "NDArray[np.float64]"

MOST_DRAWN: Final = 2500
"""More tubes are drawn as a picture: as lines they would make the file large."""
MOST_NAMES: Final = 40
NEAR_MM: Final = 30.0
LOOKS: Final = {
    "open": {"facecolor": "white", "edgecolor": "0.25", "linewidth": 0.5},
    "unknown": {"facecolor": "0.95", "edgecolor": "0.5", "linewidth": 0.5},
    "plugged": {"facecolor": "0.6", "edgecolor": "black", "linewidth": 0.6, "hatch": "xxxxxx"},
    "absent": {"facecolor": "none", "edgecolor": "0.6", "linewidth": 0.4, "linestyle": ":"},
    "predicted": {"facecolor": "none", "edgecolor": "0.75", "linewidth": 0.4, "linestyle": "--"},
}


def plan(sheet: Sheet, lattice: Lattice) -> Html:
    """Draw one count of tubes: all of it, and what is near the guide."""
    places = np.array(list(sheet.tubes) or np.zeros((0, 2)), np.int64)
    points = lattice.sheet_points(places[:, 0], places[:, 1])
    probe = np.array(list(sheet.probe_mm.values()))

    def draw(figure: Figure) -> None:
        axes = list(figure.subplots(1, 1 + bool(len(probe)), squeeze=False)[0])
        for ax in axes:
            _tubes(ax, sheet, points, lattice)
            _tracks(ax, sheet)
            ax.set_aspect("equal")
            ax.grid(visible=False)
            ax.set_xlabel("X of the sheet, mm")
        tracks = np.array([*sheet.camera_mm.values(), *sheet.seen_mm.values()])
        _show(axes[0], *_around(points if len(points) else tracks, tracks))
        if len(probe):
            _show(axes[1], *_around(probe, probe[:0]))
            _names(axes[1], sheet, lattice)
            axes[1].set_title("near the guide")
        axes[0].set_title("all that was seen")
        axes[0].set_ylabel("Y, mm")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)

    return drawn(f"plan{sheet.number}", _caption(sheet), 4.4 if len(probe) else WIDTH_IN, draw)


def _around(points: Points, tracks: Points) -> tuple[Points, Points]:
    """Corners of a square: all points, and tracks as far as they are not beside them by far."""
    low, high = points.min(axis=0), points.max(axis=0)
    reach = (high - low) / 2 + NEAR_MM
    near = tracks[((tracks >= low - reach) & (tracks <= high + reach)).all(axis=1)]
    low, high = np.min([low, *near], axis=0), np.max([high, *near], axis=0)
    half = float((high - low).max()) / 2 + NEAR_MM
    return (low + high) / 2 - half, (low + high) / 2 + half


def _show(ax: Axes, low: Points, high: Points) -> None:
    """Show a part of the sheet, Y down."""
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(high[1], low[1])


def _tubes(ax: Axes, sheet: Sheet, points: Points, lattice: Lattice) -> None:
    states = np.array([tube.state for tube in sheet.tubes.values()], object)
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
    _track(ax, sheet.seen_mm, "where the camera looks", "0.45", ":")
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
    """Name the tubes that the guide stood before for the longest."""
    longest = sorted(sheet.visits.items(), key=lambda item: -item[1].verdicts.total())[:MOST_NAMES]
    for (row, column), visit in longest:
        at = lattice.sheet_points(np.array([row]), np.array([column]))[0]
        text = visit.tube.replace(" ", "\n")
        name = ax.annotate(text, (at[0], at[1]), fontsize=5, ha="center", va="center", clip_on=True, zorder=5)
        name.set_path_effects([Stroke(linewidth=1.5, foreground="white"), Normal()])
        name.set_in_layout(False)


def _caption(sheet: Sheet) -> str:
    return (
        f"From {sheet.pictures:,} pictures with a pose, as seen from the bowl: X to the right, Y down, as the first"
        " picture laid them. A ring is where a track begins, a square where it ends. Crossed: plugged. Broken: never"
        " seen, predicted from the others."
    )
