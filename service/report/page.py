"""The report as one page: everything in it, nothing fetched, fit for paper."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from importlib.resources import files
from typing import TYPE_CHECKING, Final

from drivers.errors import ConfigError
from service.config.station import read_station
from service.report.alarms import recorded_alarms
from service.report.digest import read_digest
from service.report.evidence import evidence_section
from service.report.findings import check, checked_section
from service.report.map_plot import overview
from service.report.markup import Html, element, section
from service.report.plan_plot import plan
from service.report.sections import (
    alarms_section,
    configuration_section,
    device_section,
    events_section,
    losses_section,
    summary_section,
    tubes_section,
)
from service.report.timeline import days
from service.report.timeline_plot import Moment, timeline
from service.report.wording import utc

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from service.config.station import Station
    from service.report.alarms import RecordedAlarm
    from service.report.digest import Digest
    from service.sinks.evidence import EvidenceRecord
    from service.sinks.session.reader import RecordedSession

__all__ = ["Report", "make_report"]

POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What a browser is told: to fetch nothing, and to run nothing."""
MOST_SHEETS: Final = 4
MOST_MOMENTS: Final = 100


class Report(str):
    """The page, and how many grave problems it tells of."""

    __slots__ = ("problems",)
    problems: int


def make_report(
    session: RecordedSession, now_ns: int, progress: Callable[[str, int, int], None] = lambda _what, _done, _total: None
) -> Report:
    """Make a session's report.

    Parameters
    ----------
    session
        Whole, interrupted or damaged.
    now_ns
        UTC, since 1970.
    progress
        Told what is being done, how much of it is done, and how much it is.
    """
    records = _records(session)
    checked = check(session.folder, len(records), lambda done, total: progress("checking", done, total))
    digest = read_digest(session, lambda done, total: progress("results", done, total))
    alarms = recorded_alarms(session.events())
    station = _station(session, digest)
    bands = None if station is None or station.alignment is None else station.alignment.bands
    page = element(
        "body",
        _title(session, now_ns),
        summary_section(session, digest, checked, len(alarms), sum(r.values["agrees"] is False for r in records)),
        checked_section(checked, digest),
        section("Timeline", timeline(digest, bands, _moments(records, alarms)), class_="page"),
        alarms_section(alarms),
        _plans(digest, station),
        tubes_section(digest),
        evidence_section(session, records, checked, lambda done, total: progress("pictures", done, total)),
        losses_section(digest),
        events_section(session.events()),
        device_section(session),
        configuration_section(session),
    )
    report = Report(f"<!DOCTYPE html>\n{element('html', _head(session), page, lang='en')}\n")
    report.problems = checked.problems
    return report


def _head(session: RecordedSession) -> Html:
    style = files("service.report").joinpath("report.css").read_text(encoding="utf-8")
    return element(
        "head",
        element("meta", charset="utf-8"),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'),
        element("meta", name_="viewport", content="width=device-width, initial-scale=1"),
        element("title", f"Bowlsight report: {session.name}"),
        Html(f"<style>{style}</style>"),
    )


def _title(session: RecordedSession, now_ns: int) -> Html:
    about = session.about
    version = about.software.get("bowlsight", "?")
    made = f"Recorded by Bowlsight {version}; report made {utc(now_ns)}."
    banner = element("p", about.what, class_="banner") if about.what != "LIVE" else None
    return element("header", banner, element("h1", f"Session {session.name}"), element("p", made))


def _records(session: RecordedSession) -> list[EvidenceRecord]:
    """The evidence that is sound, without what was measured: there may be many. What is not sound, the check tells."""
    try:
        return [replace(r, values={k: v for k, v in r.values.items() if k != "result"}) for r in session.evidence()]
    except OSError:
        return []


def _station(session: RecordedSession, digest: Digest) -> Station | None:
    try:
        return read_station(session.station)
    except ConfigError as error:
        digest.problems[f"configuration: {error}"] += 1
        return None


def _moments(records: Sequence[EvidenceRecord], alarms: Sequence[RecordedAlarm]) -> list[Moment]:
    """What is marked in the timeline, the first of each."""
    signs = [(record.values["utc"], "V") for record in records if record.values["kind"] != "periodic"][:MOST_MOMENTS]
    signs += [(alarm.raised_utc, "A") for alarm in alarms if alarm.raised_utc is not None][:MOST_MOMENTS]
    return [Moment(days(datetime.fromisoformat(when).timestamp() * 1e9), sign) for when, sign in signs]


def _plans(digest: Digest, station: Station | None) -> Html:
    """Plans of the sheet, of the counts of tubes with most pictures."""
    if station is None or not digest.sheets:
        return section("Tubesheet", element("p", "There is no picture with a pose and a sound configuration: no plan."))
    most = sorted(digest.sheets.values(), key=lambda sheet: -sheet.pictures)[:MOST_SHEETS]
    rule = station.identity.rule(station.generator)
    drawn: list[Html | None] = []
    for sheet in sorted(most, key=lambda sheet: sheet.number):
        drawn += [plan(sheet, station.generator.lattice), overview(sheet, rule)]
    note = (
        "Each time the source was reopened, or an anchor settled an index of which nothing was known, counting of rows"
        " and columns began anew: such plans have nothing in common."
    )
    more = element("p", note) if len(digest.sheets) > 1 else None
    return section("Tubesheet", more, *drawn)
