"""Which old sessions go, so that the disk does not fill: never one that is being recorded."""

from __future__ import annotations

import logging
import os
import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING

from service.sinks.session.places import is_running, session_folders, size_bytes

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["Kept", "delete_old", "superfluous"]

log = logging.getLogger(__name__)

DELETING = ".deleting-"
"""What is put before the name of a session that is being deleted; one that was not finished goes the next time."""
DAY_S, GIB = 86400.0, 2**30


@dataclass(frozen=True, slots=True)
class Kept:
    """A session that is there: when it was last written to (s since 1970), its size, whether it is being recorded."""

    folder: Path
    written_s: float
    size_bytes: int
    running: bool


def superfluous(
    sessions: Sequence[Kept], now_s: float, max_age_days: float | None, max_size_gib: float | None
) -> list[Kept]:
    """What is too old, and of the rest the oldest of what is too much, in that order."""
    oldest_first = sorted(sessions, key=lambda s: s.written_s)
    too_old = [s for s in oldest_first if max_age_days is not None and now_s - s.written_s > max_age_days * DAY_S]
    going = [s for s in too_old if not s.running]
    total = sum(s.size_bytes for s in sessions) - sum(s.size_bytes for s in going)
    for session in oldest_first:
        if max_size_gib is None or total <= max_size_gib * GIB:
            break
        if not session.running and session not in going:
            going.append(session)
            total -= session.size_bytes
    return going


def delete_old(root: Path, now_s: float, max_age_days: float | None, max_size_gib: float | None) -> list[str]:
    """Delete what is superfluous in a folder of sessions; says in words what was deleted, and what could not be."""
    if max_age_days is None and max_size_gib is None:
        return []
    said = []
    for leftover in root.glob(f"{DELETING}*"):
        shutil.rmtree(leftover, ignore_errors=True)
    for session in superfluous([_kept(f) for f in session_folders(root)], now_s, max_age_days, max_size_gib):
        try:
            _delete(session.folder)
        except OSError as error:
            said.append(f"session {session.folder.name} should go, but cannot be deleted: {error.strerror}")
            log.warning("%s", said[-1])
        else:
            age = (now_s - session.written_s) / DAY_S
            said.append(
                f"deleted session {session.folder.name}: {session.size_bytes / GIB:.2f} GiB, {age:.1f} days old"
            )
            log.info("%s", said[-1])
    return said


def _kept(folder: Path) -> Kept:
    newest = max((p.stat().st_mtime for p in (folder, *folder.glob("*.jsonl"))), default=0.0)
    return Kept(folder, newest, size_bytes(folder), is_running(folder))


def _delete(folder: Path) -> None:
    """Delete a folder; it is no session any more from the first moment on."""
    going = folder.with_name(f"{DELETING}{folder.name}")
    os.rename(folder, going)  # noqa: PTH104 - Path.rename is the same
    shutil.rmtree(going)
