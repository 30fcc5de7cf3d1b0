"""Where things are in a session's folder, and which folders are sessions."""

from __future__ import annotations

import errno
import fcntl
import os
from contextlib import suppress
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from drivers.session_index import INDEX
from service.sinks.session.surroundings import utc_text

if TYPE_CHECKING:
    from pathlib import Path

__all__ = [
    "ABOUT", "CONFIG", "CSV", "EVENTS", "EVIDENCE", "LOCK", "MEMORY", "RESULTS", "STATION", "VIEWER", "SessionLock",
    "is_full", "is_running", "make_folder", "session_folders", "size_bytes",
]  # fmt: skip

ABOUT, RESULTS, EVENTS, CSV, VIEWER = "session.toml", "results.jsonl", "events.jsonl", "results.csv", "viewer.rrd"
CONFIG, EVIDENCE = "config", "evidence"
MEMORY = "memory.npz"
STATION = "station.toml"
LOCK = ".recording"
"""Held locked as long as the session is being recorded, by whatever program; gone when it was closed."""


def make_folder(root: Path, began_ns: int, what: str) -> Path:
    """Make a new session's folder, named by when it began and what it shows.

    Raises
    ------
    ConfigError
        It cannot be made there.
    OSError
        There is no room left for it.
    """
    name = f"{utc_text(began_ns)[:19].replace(':', '')}Z-{what}"
    try:
        root.mkdir(parents=True, exist_ok=True)
        for again in ["", *(f"-{i}" for i in range(2, 1000))]:
            with suppress(FileExistsError):
                (root / f"{name}{again}").mkdir()
                return root / f"{name}{again}"
    except OSError as error:
        if is_full(error):
            raise
        remedy = "name a folder that this user may write to, by --record or [recording] folder"
        raise ConfigError(f"{root}: no session can be recorded there: {error.strerror}; {remedy}") from None
    raise ConfigError(f"{root}: has a thousand sessions named {name}; move them away")


def is_full(error: OSError) -> bool:
    """Whether an error says that there is no room: on the disk, or of this user's share of it."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


class SessionLock:
    """Says to other programs that a session is being recorded; goes with this program, however that ends."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK
        self._handle = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def release(self) -> None:
        """Say that it is over."""
        with suppress(OSError):
            self._path.unlink()
        os.close(self._handle)


def is_running(folder: Path) -> bool:
    """Whether some program records this session now."""
    try:
        handle = os.open(folder / LOCK, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def session_folders(root: Path) -> list[Path]:
    """Folders of sessions directly in `root`, oldest first by their names; raises OSError where it cannot be read."""
    found = [p for p in root.iterdir() if p.is_dir() and not p.is_symlink() and not p.name.startswith(".")]
    return sorted(p for p in found if (p / INDEX).is_file() or (p / ABOUT).is_file())


def size_bytes(folder: Path) -> int:
    """What a folder takes, with all that is in it; files that go meanwhile count as nothing."""
    total = 0
    for path in folder.rglob("*"):
        with suppress(OSError):
            total += path.lstat().st_size
    return total
