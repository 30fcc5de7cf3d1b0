"""`bowlsight sessions`: what was recorded, listed and searched."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import date
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from service.cli.inputs import station
from service.config.recording import default_folder
from service.sinks.session.library import Query, find_sessions

if TYPE_CHECKING:
    import argparse

    from service.sinks.session.library import Entry

__all__ = ["run"]

HEADER = f"{'session':34} {'for':>8} {'frames':>9} {'measured':>9} {'evidence':>8} {'GB':>7}  what"


def run(args: argparse.Namespace) -> int:
    """List them; returns the exit status."""
    root = args.folder or station(args.config).recording.folder or default_folder()
    query = Query(args.words, args.tube, _day(args.since, "--since"), _day(args.until, "--until"))
    found = find_sessions(root, query, rebuild=args.rebuild)
    if args.json:
        for entry in found:
            print(json.dumps(asdict(entry) | {"folder": str(root / entry.name)}))
        return 0
    if found:
        print(HEADER)
    for entry in found:
        print(_row(entry))
    print(f"{len(found)} session{'s' * (len(found) != 1)} in {root}")
    return 0


def _day(text: str | None, option: str) -> str | None:
    try:
        return None if text is None else date.fromisoformat(text).isoformat()
    except ValueError:
        raise ConfigError(f"{option} = {text!r}: must be a day, such as 2026-11-22") from None


def _row(e: Entry) -> str:
    minutes, seconds = divmod(round(e.seconds), 60)
    lost = f", {e.overflowed:,} frames lost" if e.overflowed else ""
    end = "" if e.end == "closed" else f", {e.end.upper()}"
    who = " ".join(
        part for part in (e.what, e.steam_generator, e.leg, e.source, e.operator and f"by {e.operator}") if part
    )
    return (
        f"{e.name:34} {f'{minutes}:{seconds:02d}':>8} {e.frames:9,} {e.measured:9,} {e.evidence:8,}"
        f" {e.size_bytes / 1e9:7.3f}  {who}{lost}{end}"
    )
