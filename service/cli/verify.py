"""`bowlsight verify`: a session's chain of evidence, its hashes, and on request its measurements."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from drivers.errors import ConfigError, DeviceError
from drivers.session_replay import is_session
from service.cli.again import measured_as_recorded, remembered
from service.cli.live import prepare_kernels
from service.cli.progress import progress
from service.sinks.evidence import without_times
from service.sinks.evidence_check import record_key
from service.sinks.session.comparison import Comparison
from service.sinks.session.finding import Finding
from service.sinks.session.reader import open_session
from service.sinks.session.verification import verify_session

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from pathlib import Path

    from service.sinks.session.reader import RecordedSession

__all__ = ["run"]

MOST_SHOWN = 50


def run(args: argparse.Namespace) -> int:
    """Check it, and say what is wrong; returns the exit status."""
    if not is_session(args.session):
        raise ConfigError(f"{args.session}: is no recorded session; bowlsight sessions lists those there are")
    with progress() as show:
        findings = list(verify_session(args.session, progress=lambda done, total: show("reading", done, total)))
    if args.recompute:
        findings += _recomputed(args.session)
    for finding in findings[:MOST_SHOWN]:
        print(finding)
    if len(findings) > MOST_SHOWN:
        print(f"... and {len(findings) - MOST_SHOWN} more")
    grave = sum(finding.grave for finding in findings)
    problems = f"{grave} problem{'s' * (grave != 1)}"
    print(f"{args.session.name}: {problems if grave else _sound(args.session)}")
    return int(grave > 0)


def _sound(folder: Path) -> str:
    """What a sound session holds; the last hash is what somebody else can keep, to hold against it later."""
    session = open_session(folder)
    counts, head = session.counts(), ""
    for record in session.evidence():
        head = f"; evidence ends with {record.sha256}"
    return f"sound: {counts.frames:,} frames, {counts.measured:,} measured, {counts.evidence:,} evidence records{head}"


def _recomputed(folder: Path) -> Iterator[Finding]:
    """Measure everything again, and hold results and evidence against what comes of it."""
    try:
        session = open_session(folder)
        prepare_kernels()
        yield from _compared(session)
    except (ConfigError, DeviceError) as error:
        yield Finding(folder.name, f"cannot be measured again: {error}")


def _compared(session: RecordedSession) -> Iterator[Finding]:
    memory = remembered(session)
    comparison = Comparison(session, remembered=memory is not None)
    evidence = {record_key(record)[:3]: record for record in session.evidence()}
    measured = session.counts().measured
    with progress() as show:
        for done, (frame, results) in enumerate(measured_as_recorded(session, memory), 1):
            show("measuring", done, measured)
            comparison.accept(frame, results)
            record = evidence.get((frame.generation, frame.sequence, frame.timestamp_ns))
            if record is not None and comparison.exact:
                now = [without_times(json.loads(result.to_json())) for result in results]
                if record.values["result"] not in now:
                    yield Finding("evidence", f"record {record.number} is not what its frame measures now")
    print("\n".join(comparison.lines()))
    if comparison.problem is not None:
        yield Finding("results.jsonl", comparison.problem)
