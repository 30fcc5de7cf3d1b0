"""The report's parts in words and tables: summary, tubes, alarms, events, losses, and what it was recorded with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from drivers.errors import ConfigError
from service.config.cameras import read_camera
from service.config.table import read_toml
from service.report.digest import VERDICTS
from service.report.losses import MOST_LOSSES
from service.report.markup import Html, element, facts, free, section, table
from service.report.wording import clock, duration, figure, lasting, mark, plain, share, utc
from service.sinks.evidence_record import CalibrationUsed
from service.sinks.session.places import CONFIG
from service.vision.camera import OpenCVLens, TsaiLens

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from service.report.alarms import RecordedAlarm
    from service.report.digest import Digest
    from service.report.findings import Checked
    from service.sinks.session.reader import RecordedSession
    from service.vision.camera import Camera

__all__ = [
    "alarms_section", "configuration_section", "device_section", "events_section", "losses_section", "summary_section",
    "tubes_section",
]  # fmt: skip

MOST_VISITS: Final = 200
MOST_EVENTS: Final = 300
MOST_FILE_CHARACTERS: Final = 12_000
QUIET: Final = ("tubes", "alarm")
"""Kinds of events that stand elsewhere in the report."""


def summary_section(session: RecordedSession, digest: Digest, checked: Checked, alarms: int, contradicted: int) -> Html:
    """Say what it comes to."""
    c, about = digest.counts, session.about
    pictures, judged = digest.locks.total(), digest.verdicts.total()
    lost = sum(digest.losses.totals[k] for k in (digest.losses.MISSING, digest.losses.NO_ROOM))
    visited = sum(len(sheet.visits) for sheet in digest.sheets.values())
    rows: list[tuple[str, str | None]] = [
        ("what", about.what),
        ("where", " ".join(p for p in (about.generator, about.steam_generator, about.leg) if p)),
        ("operator", about.operator),
        ("from", f"{utc(c.began_ns)} ({about.utc_source})"),
        ("until", f"{utc(c.ended_ns)}; {duration(digest.seconds)}"),
        ("ended", str(c.end).upper() if c.reason is None else f"{c.end}: {c.reason}"),
        ("frames recorded", f"{c.frames:,}"),
        ("frames measured", share(c.measured, c.frames)),
        ("frames lost", f"{lost:,}, see Lost" if lost else "none that is known of"),
        ("locked in full", share(digest.locks["full"], pictures)),
        *[(mark(v), share(digest.verdicts[v], judged)) for v in VERDICTS if judged],
        ("tubes the guide stood before", f"{visited:,}"),
        ("alarms", f"{alarms:,}"),
        ("claims that the picture contradicts", f"{contradicted:,}"),
        ("evidence", checked.chain),
    ]
    return section("Summary", facts(rows), _notes(session, digest))


def _notes(session: RecordedSession, digest: Digest) -> Html:
    notes = []
    if session.damage is not None:
        notes.append(
            f"✖ The session's description cannot be read: {session.damage}. Who recorded it, with which device and"
            " software, is not known; calibration and configuration are what lies in its folder now."
        )
    if not digest.verdicts:
        notes.append("No guide was set up: there are neither offsets nor verdicts.")
    if not session.about.from_start:
        notes.append("The recording began in the midst of a watch: what was before is not in it.")
    if digest.counts.end == "interrupted":
        notes.append("INTERRUPTED: the recording was not closed in order; up to a second of its end may be missing.")
    if digest.counts.end == "recording":
        notes.append("STILL BEING RECORDED when this report was made: it ends there.")
    return element("ul", *(element("li", note) for note in notes)) if notes else Html()


def tubes_section(digest: Digest) -> Html:
    """List the tubes that the guide stood before, in their order."""
    visits = sorted((v for sheet in digest.sheets.values() for v in sheet.visits.values()), key=lambda v: v.first_ns)
    if not visits:
        return section("Tubes", element("p", "The guide stood before no tube that is known."))
    rows = [
        (
            free(visit.tube), clock(visit.first_ns), clock(visit.last_ns), f"{visit.verdicts.total():,}",
            figure(visit.best_mm, visit.best_sigma_mm, "mm"),
            "; ".join(f"{mark(v)} {visit.verdicts[v]:,}" for v in VERDICTS if visit.verdicts[v]),
        )
        for visit in visits[:MOST_VISITS]
    ]  # fmt: skip
    more = f"and {len(visits) - MOST_VISITS:,} more" if len(visits) > MOST_VISITS else None
    head = ("tube", "first, UTC", "last, UTC", "pictures", "smallest offset", "verdicts")
    return section("Tubes", table(head, rows, "wide"), element("p", more) if more else None)


def alarms_section(alarms: Sequence[RecordedAlarm]) -> Html:
    """List the alarms as they were raised."""
    if not alarms:
        text = "None was recorded. Alarms are kept by the operator's page: a service without it raises none."
        return section("Alarms", element("p", text))
    rows = [
        (
            "FIRST" if a.first else "", "before" if a.raised_utc is None else clock(a.raised_utc), free(a.reason),
            "" if a.value is None else f"{a.value:.3g} {a.unit}".strip(),
            "" if a.limit is None else f"{a.limit:.3g} {a.unit}".strip(),
            f"{a.times:,}", clock(a.cleared_utc) if a.cleared_utc else "not until the end",
            free(f"{clock(a.acknowledged_utc)} {a.by}") if a.acknowledged_utc else "NEVER",
        )
        for a in alarms
    ]  # fmt: skip
    text = "FIRST came when no other stood; those below it are often its consequence."
    head = ("", "raised, UTC", "why", "value", "limit", "times", "cleared", "acknowledged")
    return section("Alarms", element("p", text), table(head, rows, "wide"))


def events_section(events: Iterable[Mapping[str, Any]]) -> Html:
    """List what happened; what is no warning is left out first where it is too much."""
    kept = [event for event in events if event.get("kind") not in QUIET]
    shown = kept
    if len(kept) > MOST_EVENTS:
        grave = [event for event in kept if event.get("level") != "INFO"][:MOST_EVENTS]
        shown = grave or kept[:MOST_EVENTS]
    rows = [
        (
            clock(str(e.get("utc", ""))),
            str(e.get("level", "")),
            free(str(e.get("kind", ""))),
            free(str(e.get("text", ""))),
        )
        for e in shown
    ]
    more = f"{len(kept) - len(shown):,} more stand in events.jsonl." if len(shown) < len(kept) else None
    listed = table(("UTC", "level", "kind", "what"), rows, "wide") if rows else element("p", "None was recorded.")
    return section("Events", listed, element("p", more) if more else None)


def losses_section(digest: Digest) -> Html:
    """Say what was lost, and when."""
    losses, c = digest.losses, digest.counts
    totals = [(kind, f"{count:,}") for kind, count in losses.totals.items()]
    unmeasured = ("frames recorded and not measured", share(c.frames - c.measured, c.frames))
    notes = (
        [] if losses.numbered or not c.frames else ["The source does not count its frames: what it lost is not known."]
    )
    if losses.totals[losses.NO_ROOM] and losses.totals[losses.MISSING]:
        notes.append("Frames that found no room in the recorder are missing in the source's count, too.")
    rows = [
        (
            lasting(loss.from_ns, loss.until_ns),
            loss.kind,
            f"{loss.frames:,}" if loss.frames else duration((loss.until_ns - loss.from_ns) / 1e9),
        )
        for loss in losses.listed
    ]
    if len(losses.listed) == MOST_LOSSES:
        notes.append(f"The first {MOST_LOSSES} are listed; the sums are of all.")
    listed = (
        table(("UTC", "what", "frames, or how long"), rows, "wide")
        if rows
        else element("p", "Nothing is known to be lost.")
    )
    return section("Lost", facts([unmeasured, *totals]), *(element("p", note) for note in notes), listed)


def device_section(session: RecordedSession) -> Html:
    """Say what it was recorded with."""
    about = session.about
    device = {k: v for k, v in about.device.items() if k != "controls"} | dict(about.device.get("controls", {}))
    return section(
        "Device, calibration, software",
        element("h3", "Device"),
        facts((str(k), plain(v)) for k, v in device.items()) if device else element("p", "Nothing was told of it."),
        element("h3", "Calibration"),
        _calibration(session),
        element("h3", "Software and machine"),
        facts((k, plain(v)) for k, v in (*about.software.items(), *about.machine.items())),
    )


def _calibration(session: RecordedSession) -> Html:
    name = next((name for name in session.about.files if name.startswith("camera/")), None)
    if name is None:
        return element("p", "Without a camera file: all but the pixels was estimated, frame by frame.")
    try:
        camera, told = read_camera(session.folder / CONFIG / name), read_toml(session.folder / CONFIG / name)
    except ConfigError as error:
        return element("p", f"✖ {error}", class_="missing")
    used = CalibrationUsed(calibrated_utc=told.text("calibrated_utc", None)).at(session.started_ns)
    x, y = camera.principal_point_px or camera.middle_px
    sigmas = ", ".join(f"{p} {camera.sigma(p):.3g}" for p in camera.parameters)
    return facts(
        [
            ("camera", camera.name),
            ("file", f"{name}, SHA-256 {session.about.files[name]}"),
            ("calibrated", told.text("calibrated_utc", None)),
            ("age", figure(used["age_days"], None, "days", 1)),
            ("residual", figure(told.number("reprojection_error_px", None), None, "px", 3)),
            ("picture", plain(list(camera.image_size_px)) + " px"),
            ("focal length", figure(camera.focal_length_mm, camera.sigma("focal_length_mm") or None, "mm", 3)),
            ("principal point", f"{x:.2f}, {y:.2f} px" if camera.principal_point_px else "estimated"),
            ("lens", _lens(camera)),
            ("sigmas", sigmas or "none: what is given counts as exact"),
        ]
    )


def _lens(camera: Camera) -> str:
    match camera.lens:
        case TsaiLens(kappa1_per_mm2=kappa1):
            return f"kappa1 {kappa1:.6g} per mm²"
        case OpenCVLens(coefficients=coefficients):
            return f"k1, k2, p1, p2, k3: {', '.join(f'{c:.6g}' for c in coefficients)}"
        case None:
            return "estimated"


def configuration_section(session: RecordedSession) -> Html:
    """Print the configuration as it was, with its hashes."""
    about, shown = session.about, []
    for name in about.files:
        try:
            text = (session.folder / CONFIG / name).read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            shown.append(element("p", f"✖ {name}: cannot be read: {error.strerror}", class_="missing"))
            continue
        cut = text if len(text) <= MOST_FILE_CHARACTERS else f"{text[:MOST_FILE_CHARACTERS]}\n[...]"
        shown += [element("h3", name), element("pre", cut)]
    said = [("anchors", ", ".join(about.anchors)), ("target", about.target)]
    hashes = table(("file", "SHA-256"), about.files.items(), "hashes")
    joint = element("p", f"All together: {about.configuration_sha256}", class_="hash")
    return section("Configuration", facts(said), hashes, joint, *shown)
