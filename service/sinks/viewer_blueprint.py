"""How the viewer lays the views out for an operator."""

from __future__ import annotations

import numpy as np

from service.sinks.quiet_rerun import rr, rrb
from service.sinks.viewer_drawing import FRAME, TIME

__all__ = ["blueprint"]

TREND_S = 60
GREY = (38, 40, 43, 255)
LEGEND = "Picture: ring measured, cross predicted, crossed ring plugged, dot absent; pale: in doubt"


def blueprint(size_px: tuple[int, int], distance_mm: float) -> rrb.Blueprint:
    """Lay out picture, state and events at the left, readings, sheet and trends at the right; no panels.

    The picture of `size_px` fills its view. The sheet is seen from beside the camera, which stands still and looks up,
    so that it is never lost from sight; `distance_mm` says how far to step back.
    """
    window = rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-TREND_S),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=0),
    )
    ranges = rrb.VisibleTimeRange(TIME, range=window)
    last_minute = rrb.TimeAxis(view_range=window, zoom_lock=True)

    def trend(name: str, title: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=f"/trend/{name}",
            name=title,
            axis_x=last_minute,
            time_ranges=ranges,
            plot_legend=rrb.PlotLegend(visible=False),
        )

    left = rrb.Vertical(
        rrb.Spatial2DView(
            origin="/picture",
            name=LEGEND,
            background=GREY,
            visual_bounds=rrb.VisualBounds2D(x_range=(0, size_px[0]), y_range=(0, size_px[1])),
        ),
        rrb.Horizontal(
            rrb.StateTimelineView(origin="/state", name="Source and lock", time_view=last_minute, time_ranges=ranges),
            rrb.TextLogView(
                origin="/events",
                name="Events",
                columns=rrb.TextLogColumns(timeline_columns=[FRAME], text_log_columns=["loglevel", "body"]),
            ),
            column_shares=[1, 1],
        ),
        row_shares=[9, 2],
    )
    right = rrb.Vertical(
        rrb.Tabs(
            rrb.TextDocumentView(origin="/status", name="Readings"),
            rrb.TextDocumentView(origin="/health", name="Health"),
        ),
        rrb.Spatial3DView(
            origin="/sheet/camera",
            contents="/sheet/**",
            name="Tubesheet and camera",
            background=GREY,
            line_grid=False,
            eye_controls=rrb.EyeControls3D(
                kind=rrb.Eye3DKind.Orbital,
                position=np.array([-0.9, -0.9, 0.15]) * distance_mm,
                look_target=np.array([0.0, 0.0, 0.5]) * distance_mm,
                eye_up=(0, 0, 1),
            ),
        ),
        trend("distance", "Distance, mm (± 1 sigma)"),
        trend("tilt", "Tilt, deg (± 1 sigma)"),
        row_shares=[3.4, 3.2, 1.9, 1.9],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[5, 3]),
        rrb.TopPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIME, play_state="following"),
        auto_layout=False,
        auto_views=False,
    )
