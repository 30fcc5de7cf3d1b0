"""Figures, times and shares in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from service.sinks.session.surroundings import utc_text

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["clock", "duration", "figure", "lasting", "mark", "offset", "plain", "share", "utc"]

MARKS = {"aligned": "✔", "adjust": "▲", "cannot judge": "◆", "no lock": "✖", "stale": "◌"}
LONG_S = 3600


def mark(verdict: str | None) -> str:
    """A verdict with its sign."""
    return "—" if verdict is None else f"{MARKS.get(verdict, '')}\N{NO-BREAK SPACE}{verdict}".strip()


def figure(value: float | None, sigma: float | None, unit: str, digits: int = 2) -> str:
    """A value with unit and sigma; a dash where there is none."""
    if value is None:
        return "—"
    plus = "" if sigma is None else f"\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}{sigma:.{digits}f}"
    return f"{value:.{digits}f}{plus}\N{NO-BREAK SPACE}{unit}".strip()


def offset(values: Sequence[float] | None, sigma: float | None) -> str:
    """An offset in the sheet's axes, mm."""
    if values is None:
        return "—"
    x, y = values
    return f"{figure((x * x + y * y) ** 0.5, sigma, 'mm')} (X {x:+.2f}, Y {y:+.2f})"


def duration(seconds: float) -> str:
    """A time span: 12.3 s, 4 min 05 s, 3 h 12 min."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < LONG_S:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def utc(wall_ns: int | None) -> str:
    """UTC in full."""
    return "—" if wall_ns is None else utc_text(wall_ns).replace("T", " ").replace("Z", " UTC")


def clock(moment: int | str | None) -> str:
    """The time of day, UTC, of nanoseconds or of a time as files have it."""
    if moment is None:
        return "—"
    text = utc_text(moment) if isinstance(moment, int) else moment
    return text[11:].rstrip("Z") if len(text) > 11 else text


def lasting(from_ns: int, until_ns: int) -> str:
    """A time of day, or from one to another."""
    return clock(from_ns) if from_ns == until_ns else f"{clock(from_ns)} to {clock(until_ns)}"


def share(part: int, whole: int) -> str:
    """A number and its share."""
    return f"{part:,} ({part / whole:.1%})" if whole else f"{part:,}"


def plain(value: Any) -> str:
    """A value of a description, such as a list."""
    return " x ".join(map(str, value)) if isinstance(value, list) else str(value)
