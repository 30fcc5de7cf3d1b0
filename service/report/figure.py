"""Plots as SVG that stands in a page: no display, no fonts of this machine, nothing that is loaded from elsewhere."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from service.report.markup import Html, element

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["WIDTH_IN", "drawn"]

WIDTH_IN: Final = 7.1
"""Between the margins of an A4 page."""
RASTER_DPI: Final = 200
"""Of what is drawn as a picture because it is too much for lines."""
STYLE: Final[dict[Any, Any]] = {
    "svg.fonttype": "none",  # texts stay texts: to be searched, and in whatever font the reader has
    "svg.hashsalt": "bowlsight",
    "text.parse_math": False,  # a name may hold a dollar sign
    "font.family": "sans-serif",
    "font.size": 8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "grid.color": "0.85",
    "grid.linewidth": 0.5,
    "hatch.linewidth": 0.5,
    "legend.fontsize": 7,
    "legend.framealpha": 1.0,
    "path.simplify_threshold": 0.2,
}
NOTHING: Final = {"Date": None, "Creator": None, "Format": None, "Type": None}


def drawn(name: str, caption: str, height_in: float, draw: Callable[[Figure], None]) -> Html:
    """Make a figure of the page; `name` keeps its parts apart from those of other figures."""
    with mpl.rc_context(STYLE):
        figure = Figure((WIDTH_IN, height_in), dpi=RASTER_DPI, layout="constrained")
        draw(figure)
        out = io.StringIO()
        FigureCanvasSVG(figure).print_svg(out, metadata=NOTHING)  # type: ignore[no-untyped-call]
    return element("figure", _inlined(out.getvalue(), name), element("figcaption", caption), class_="plot")


def _inlined(svg: str, name: str) -> Html:
    """The drawing without its document head, and with names of its own."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(\bid=")', rf"\g<1>{name}-", svg)
    svg = re.sub(r'(\bhref="#|url\(#)', rf"\g<1>{name}-", svg)
    return Html(re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1))
