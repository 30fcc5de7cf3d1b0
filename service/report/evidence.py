"""The report's verifications: a table of all, and a card with its picture for those that somebody asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from service.report.markup import Content, Html, element, facts, free, section, table
from service.report.pictures import picture
from service.report.wording import clock, figure, mark, offset

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from typing import Any

    from service.report.findings import Checked
    from service.sinks.evidence import EvidenceRecord
    from service.sinks.session.reader import RecordedSession

__all__ = ["evidence_section", "with_pictures"]

MOST_PICTURES: Final = 60
MOST_ROWS: Final = 1000
HEAD: Final = ("no.", "UTC", "what", "claimed", "seen", "agree", "verdict", "offset, mm", "tilt, deg", "operator")
FIELDS: Final = {"top": ", top field", "bottom": ", bottom field"}
AGREES: Final = {True: "✔ yes", False: "✖ NO", None: "—"}


def with_pictures(records: Sequence[EvidenceRecord]) -> list[EvidenceRecord]:
    """Choose the records that are shown with their pictures: what speaks against a claim first, periodic ones last."""

    def rank(record: EvidenceRecord) -> tuple[bool, bool, int]:
        v = record.values
        return v.get("agrees") is not False and not v.get("reason"), v.get("kind") == "periodic", record.number

    return sorted(sorted(records, key=rank)[:MOST_PICTURES], key=lambda record: record.number)


def evidence_section(
    session: RecordedSession,
    records: Sequence[EvidenceRecord],
    checked: Checked,
    progress: Callable[[int, int], None],
) -> Html:
    """Show them; `records` need not have their results."""
    chain = element(
        "p", "Chain of evidence: ", element("strong", checked.chain), class_="alert" if checked.broken else None
    )
    if not records:
        return section("Verifications", chain)
    chosen = {record.number for record in with_pictures(records)}
    cards = []
    for record in session.evidence():
        if record.number in chosen:
            cards.append(_card(session, record))
            progress(len(cards), len(chosen))
    last = element("p", f"Last hash, for somebody else to keep: {records[-1].sha256}", class_="hash")
    left_out = None
    if len(records) > min(MOST_ROWS, len(chosen)):
        left_out = element("p", f"{len(records):,} records; {len(chosen):,} are shown with their pictures.")
    rows = table(HEAD, [_row(record.number, record.values) for record in records[:MOST_ROWS]], "wide")
    return section("Verifications", chain, rows, last, left_out, *cards)


def _what(values: Mapping[str, Any]) -> str:
    return str(values["kind"]) if values["mark"] is None else f"{values['kind']}: {values['mark']}"


def _row(number: int, v: Mapping[str, Any]) -> list[Content]:
    size = None if v["offset_mm"] is None else (v["offset_mm"][0] ** 2 + v["offset_mm"][1] ** 2) ** 0.5
    return [
        str(number), clock(v["utc"]), free(_what(v)), free(v["tube_claimed"] or "—"), free(v["tube_seen"] or _place(v)),
        AGREES[v["agrees"]], mark(v["verdict"]), figure(size, v["offset_sigma_mm"], ""),
        figure(v["tilt_deg"], v["tilt_sigma_deg"], ""), free(v["operator"] or "—"),
    ]  # fmt: skip


def _place(v: Mapping[str, Any]) -> str:
    place = v["place_seen"]
    return "—" if place is None else f"place {place[0]}, {place[1]}"


def _card(session: RecordedSession, record: EvidenceRecord) -> Html:
    v = record.values
    known, calibration, frame = v["map"] or {}, v["calibration"] or {}, v["frame"]
    where = " ".join(part for part in (v["steam_generator"], v["leg"], v["tube_seen"] or _place(v)) if part)
    approximate = ", approximate" if known.get("approximate") else ""
    said = facts(
        [
            ("UTC", f"{v['utc']} ({v['utc_source']})"),
            ("operator", v["operator"]),
            ("claimed", v["tube_claimed"]),
            ("seen", where),
            ("agree", AGREES[v["agrees"]]),
            ("nearer than the next by", figure(v["margin_mm"], None, "mm", 1)),
            ("overridden because", v["reason"]),
            (
                "verdict",
                f"{mark(v['verdict'])}; lock {v['lock']}{', '.join(['', *v['doubt']])}; quality {v['quality'] or '—'}",
            ),
            ("offset", offset(v["offset_mm"], v["offset_sigma_mm"])),
            ("tilt of the guide", figure(v["tilt_deg"], v["tilt_sigma_deg"], "deg")),
            ("tilt of the camera", figure(v["camera_tilt_deg"], v["camera_tilt_sigma_deg"], "deg")),
            ("distance", figure(v["distance_mm"], v["distance_sigma_mm"], "mm", 1)),
            ("map", f"{known['name']}{approximate}" if known else None),
            ("calibration", _calibration(calibration)),
            ("frame", f"{frame['sequence']} of {frame['source']}{FIELDS.get(frame['field'], '')}"),
        ]
    )
    title = element("h3", f"{record.number}: {_what(v)}, {clock(v['utc'])}")
    hashes = element("p", f"picture {v['picture_sha256']}", element("br"), f"record {record.sha256}", class_="hash")
    return element("article", title, element("div", picture(session, record), said, class_="card"), hashes)


def _calibration(c: Mapping[str, Any]) -> str | None:
    if c.get("name") is None and c.get("sha256") is None:
        return None
    age = "" if c["age_days"] is None else f", {c['age_days']:.1f} days old"
    residual = "" if c["reprojection_error_px"] is None else f", residual {c['reprojection_error_px']:.3f} px"
    return f"{c['name'] or 'camera file'}{residual}{age}, SHA-256 {str(c['sha256'])[:12]}…"
