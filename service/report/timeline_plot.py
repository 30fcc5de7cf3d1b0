"""The session over time: offset, tilts, distance, and when there were signal, lock and which verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.ticker import FuncFormatter

from service.alignment.bands import Bands
from service.report.figure import drawn
from service.report.markup import element
from service.report.timeline import days

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from service.report.digest import Digest
    from service.report.markup import Html
    from service.report.timeline import Presence

__all__ = ["Moment", "timeline"]

PANEL_IN: Final = 1.08
STRIP_IN: Final = 0.19
HEADROOM: Final = 1.3
FAR: Final = 4
"""So many times a limit are beyond what one plain scale can show."""
LOOKS: Final = {
    "good": ("0.75", None), "bad": ("0.2", None), "no frames": ("1.0", "xxxx"),
    "full": ("0.75", None), "partial": ("0.9", "////"), "none": ("0.2", None),
    "aligned": ("0.75", None), "adjust": ("0.9", "////"), "cannot judge": ("1.0", "...."), "no lock": ("0.2", None),
    "stale": ("1.0", "xxxx"),
}  # fmt: skip
"""Grey and hatching; each kind has a row of its own besides."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A time that is marked, in days since 1970: of a verification or mark ("V"), of an alarm ("A")."""

    day: float
    sign: str


@dataclass(frozen=True, slots=True)
class _Panel:
    figure: str
    title: str
    limits: tuple[float, ...] = ()


def timeline(digest: Digest, bands: Bands | None, moments: Sequence[Moment]) -> Html:
    """Draw it; without frames, say so."""
    if digest.steps is None:
        return element("p", "There is no frame in this session.")
    panels = [panel for panel in _panels(bands) if not digest.figures[panel.figure].empty]
    strips = [("signal", digest.signal), ("lock", digest.lock)]
    if digest.verdicts:
        strips.append(("verdict", digest.verdict))
    heights = [PANEL_IN] * len(panels) + [STRIP_IN * (len(p.kinds) + 1.5) for _, p in strips if p is not None]

    def draw(figure: Figure) -> None:
        axes = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
        for panel, ax in zip(panels, axes, strict=False):
            _draw_figure(ax, digest, panel)
        for (title, presence), ax in zip(strips, axes[len(panels) :], strict=True):
            assert presence is not None, "there are frames"
            _draw_strip(ax, title, presence)
        _finish(axes, digest, moments)

    return drawn("timeline", _caption(digest), sum(heights) + 0.5, draw)


def _panels(bands: Bands | None) -> list[_Panel]:
    b = bands or Bands()
    return [
        _Panel("offset_mm", "offset of the guide from its tube, mm", (b.offset_normal_mm, b.offset_advisory_mm)),
        _Panel("tilt_deg", "tilt of the guide to its tube, deg", (b.tilt_normal_deg, b.tilt_advisory_deg)),
        _Panel("parallelism_deg", "arm to sheet, deg", (b.parallelism_normal_deg,)),
        _Panel("camera_tilt_deg", "tilt of the camera, deg"),
        _Panel("distance_mm", "camera to sheet, mm"),
    ]


def _draw_figure(ax: Axes, digest: Digest, panel: _Panel) -> None:
    envelope = digest.figures[panel.figure]
    times, low, high, mean = envelope.lines()
    ax.fill_between(times, low, high, color="0.8", linewidth=0, label="lowest to highest")
    ax.plot(times, mean, color="black", linewidth=0.9, marker=".", markersize=1.5, label="mean")
    sigma = digest.figures[panel.figure.replace("_mm", "_sigma_mm").replace("_deg", "_sigma_deg")]
    if panel.limits:
        at, _, _, one = sigma.lines()
        ax.plot(at, one, color="0.35", linewidth=0.8, linestyle=":", label="one sigma")
        _scale(ax, envelope.extremes[1], panel.limits[-1])
    for limit, style in zip(panel.limits, ("-", "--"), strict=False):
        ax.axhline(limit, color="black", linewidth=0.6, linestyle=style)
        ax.annotate(
            f"{limit:g}",
            (1.0, limit),
            xycoords=("axes fraction", "data"),
            fontsize=6,
            va="center",
            annotation_clip=False,
        )
    ax.set_title(panel.title)


def _scale(ax: Axes, highest: float, limit: float) -> None:
    """Have the limits seen, however far beyond them the values are."""
    if highest > FAR * limit:
        ax.set_yscale("symlog", linthresh=2 * limit, linscale=1.5)
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_ylim(0, HEADROOM * max(highest, limit))


def _draw_strip(ax: Axes, title: str, presence: Presence) -> None:
    kinds = list(presence.kinds)
    for y, kind in enumerate(reversed(kinds)):
        grey, hatch = LOOKS[kind]
        spans: list[Any] = presence.spans(kind)
        ax.broken_barh(spans, (y - 0.4, 0.8), facecolor=grey, hatch=hatch, edgecolor="black", linewidth=0.3)
    ax.set_yticks(range(len(kinds)), list(reversed(kinds)))
    ax.set_ylim(-0.6, len(kinds) - 0.4)
    ax.set_title(title)
    ax.grid(visible=False, axis="y")


def _finish(axes: Sequence[Axes], digest: Digest, moments: Sequence[Moment]) -> None:
    steps = digest.steps
    assert steps is not None, "there are frames"
    axes[0].set_title(axes[0].get_title(loc="left"), pad=10)  # above the signs
    first, last = days(steps.began_ns), days(steps.ended_ns)
    for moment in moments:
        day, alarm = min(max(moment.day, first), last), moment.sign == "A"
        for ax in axes:
            ax.axvline(day, color="0.4", linewidth=0.6, linestyle=(0, (1, 2)) if alarm else (0, (4, 2)))
        at = (day, 1.04)
        text = axes[0].annotate(moment.sign, at, xycoords=("data", "axes fraction"), ha="center", fontsize=6)
        text.set_annotation_clip(False)
        text.set_in_layout(False)
    axes[0].set_xlim(days(steps.began_ns - steps.width_ns), days(steps.ended_ns + steps.width_ns))
    locator = AutoDateLocator()  # type: ignore[no-untyped-call]
    axes[-1].xaxis.set_major_locator(locator)
    axes[-1].xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes[-1].set_xlabel("UTC")


def _caption(digest: Digest) -> str:
    assert digest.steps is not None, "there are frames"
    step = digest.steps.width_ns / 1e9
    limits = (
        " Whole and broken lines across: limits, normal and advisory; far beyond them the scale is logarithmic."
        " Dotted: one sigma."
        if digest.verdicts
        else ""
    )
    return (
        f"Each step is {step:.2g} s: black its mean, grey from its lowest to its highest value; a gap is a time"
        f" without a measurement.{limits} V: verification or mark; A: alarm. Below, a step is filled where there was"
        " at least one picture of the kind."
    )
