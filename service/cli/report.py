"""`bowlsight report`: a session on paper."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from drivers.session_replay import is_session
from service.cli.outputs import check_outputs
from service.cli.progress import progress
from service.config.cameras import write_atomically
from service.sinks.session.reader import open_session

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Write it; returns the exit status."""
    if not is_session(args.session):
        raise ConfigError(f"{args.session}: is no recorded session; bowlsight sessions lists those there are")
    session = open_session(args.session, damaged=True)
    out = args.out or Path(f"{args.session.resolve().name}.html")
    if args.session.resolve() in out.resolve().parents:
        raise ConfigError(
            f"{out}: is in the session's own folder, where nothing is to be changed; choose another place"
        )
    check_outputs([out], [])
    logging.getLogger("matplotlib").addHandler(logging.NullHandler())  # where it keeps its fonts concerns nobody
    # plots take half a second to import: only where they are made
    from service.report.page import make_report  # noqa: PLC0415

    with progress() as show:
        report = make_report(session, time.time_ns(), show)
    write_atomically(out, report)
    size_mb = len(report.encode()) / 1e6
    problems = f"; {report.problems} problem{'s' * (report.problems != 1)}, named in it" if report.problems else ""
    print(f"{out}: report of {session.name}, {size_mb:.1f} MB{problems}")
    return int(report.problems > 0)
