"""All sessions of a folder, in an index made from them: it can be made anew at any time, and is never the truth."""

from __future__ import annotations

import logging
import sqlite3
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, Final

from drivers.errors import ConfigError, UnsupportedFormatError
from service.sinks.session.places import ABOUT, EVENTS, is_running, session_folders
from service.sinks.session.reader import SessionEnd, open_session
from service.sinks.session.surroundings import utc_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from service.sinks.session.reader import RecordedSession

__all__ = ["LIBRARY", "Entry", "Query", "find_sessions"]

log = logging.getLogger(__name__)

LIBRARY: Final = ".sessions.sqlite"
VERSION: Final = 1
DAMAGED: Final = "damaged"


@dataclass(frozen=True, slots=True)
class Entry:
    """A session in the list.

    Attributes
    ----------
    name
        Of its folder.
    started_utc, seconds
        When it began, and how long its frames last; "" and 0 where that cannot be read.
    what, generator, steam_generator, leg, operator, source
        As its description says.
    frames, measured, overflowed, evidence, size_bytes
        What there is of it.
    end
        "closed", "recording", "interrupted", or "damaged": it cannot be opened.
    """

    name: str
    started_utc: str = ""
    seconds: float = 0.0
    what: str = ""
    generator: str = ""
    steam_generator: str = ""
    leg: str = ""
    operator: str = ""
    source: str = ""
    frames: int = 0
    measured: int = 0
    overflowed: int = 0
    evidence: int = 0
    size_bytes: int = 0
    end: str = DAMAGED


@dataclass(frozen=True, slots=True)
class Query:
    """What sessions are looked for; all that is given must hold.

    Attributes
    ----------
    words
        Each is somewhere in what the session says of itself: name, operator, plant, source, events, tubes.
    tube
        Was seen by this name.
    since, until
        Days, as 2026-11-22.
    """

    words: Sequence[str] = ()
    tube: str | None = None
    since: str | None = None
    until: str | None = None


COLUMNS: Final = tuple(f.name for f in fields(Entry))


def find_sessions(root: Path, query: Query | None = None, *, rebuild: bool = False) -> list[Entry]:
    """Find sessions directly in a folder, oldest first; the index is brought up to date before.

    Raises
    ------
    ConfigError
        There is no such folder, or it cannot be read.
    """
    try:
        folders = session_folders(root)
    except OSError as error:
        raise ConfigError(f"{root}: cannot be listed: {error.strerror}; name the folder of sessions by --in") from None
    if rebuild:
        _forget(root)
    for attempt in (str(root / LIBRARY), str(root / LIBRARY), ":memory:"):
        try:
            with closing(_prepared(attempt)) as library:
                _update(library, folders)
                return _select(library, query or Query())
        except sqlite3.DatabaseError as error:
            log.info("%s: %s; made anew", root / LIBRARY, error)
            _forget(root)
    raise AssertionError("an index in memory is never damaged")


def _forget(root: Path) -> None:
    """Delete the index; where that cannot be, none is written."""
    with suppress(OSError):
        (root / LIBRARY).unlink(missing_ok=True)


def _prepared(where: str) -> sqlite3.Connection:
    library = sqlite3.connect(where, timeout=5.0)
    try:
        if library.execute("PRAGMA user_version").fetchone()[0] != VERSION:
            library.executescript(
                "DROP TABLE IF EXISTS sessions; DROP TABLE IF EXISTS tubes;"
                f"CREATE TABLE sessions ({', '.join(COLUMNS)}, stamp TEXT, said TEXT, PRIMARY KEY (name));"
                "CREATE TABLE tubes (session, tube, PRIMARY KEY (session, tube)) WITHOUT ROWID;"
                f"PRAGMA user_version = {VERSION};"
            )
        library.execute("SELECT count(*), max(stamp) FROM sessions").fetchone()
        with library:  # see now whether it can be written
            library.execute("DELETE FROM sessions WHERE name IS NULL")
    except BaseException:
        library.close()
        raise
    return library


def _update(library: sqlite3.Connection, folders: Sequence[Path]) -> None:
    """Take in what is new or has changed, and take out what is gone."""
    known = dict(library.execute("SELECT name, stamp FROM sessions").fetchall())
    there = {folder.name for folder in folders}
    with library:
        for gone in known.keys() - there:
            _remove(library, gone)
        for folder in folders:
            stamp = _stamp(folder)
            if known.get(folder.name) != stamp:
                _remove(library, folder.name)
                _insert(library, folder, stamp)


def _remove(library: sqlite3.Connection, name: str) -> None:
    library.execute("DELETE FROM sessions WHERE name = ?", (name,))
    library.execute("DELETE FROM tubes WHERE session = ?", (name,))


def _stamp(folder: Path) -> str:
    """What is another where a session has changed."""
    parts = [str(is_running(folder))]
    for name in ("index.jsonl", EVENTS, ABOUT):
        try:
            state = (folder / name).stat()
        except OSError:
            parts.append("-")
        else:
            parts.append(f"{state.st_size}:{state.st_mtime_ns}")
    return " ".join(parts)


def _insert(library: sqlite3.Connection, folder: Path, stamp: str) -> None:
    entry, tubes, said = _entry(folder)
    values = [*asdict(entry).values(), stamp, said]
    library.execute(f"INSERT INTO sessions VALUES ({', '.join('?' * len(values))})", values)  # noqa: S608 - marks only
    library.executemany("INSERT OR IGNORE INTO tubes VALUES (?, ?)", [(folder.name, _plain(tube)) for tube in tubes])


def _entry(folder: Path) -> tuple[Entry, set[str], str]:
    """What a session says of itself: its entry, the tubes it saw, and all that words are looked for in."""
    try:
        session = open_session(folder)
        entry = _described(session)
        events = list(session.events())
    except (ConfigError, UnsupportedFormatError, OSError, ValueError) as error:
        return Entry(folder.name), set(), _plain(f"{folder.name} {DAMAGED} {error}")
    tubes = {str(name) for event in events for name in event.get("names", ())}
    about = (entry.name, entry.what, entry.generator, entry.steam_generator, entry.leg, entry.operator, entry.source)
    texts = [str(event.get("text", "")) for event in events]
    return entry, tubes, _plain(" ".join([*about, *tubes, *texts]))


def _described(session: RecordedSession) -> Entry:
    about, counts = session.about, session.counts()
    lasting_ns = 0 if counts.began_ns is None or counts.ended_ns is None else counts.ended_ns - counts.began_ns
    return Entry(
        name=session.name,
        started_utc=utc_text(session.started_ns),
        seconds=round(lasting_ns / 1e9, 3),
        what=about.what,
        generator=about.generator,
        steam_generator=about.steam_generator,
        leg=about.leg,
        operator=about.operator,
        source=str(about.device.get("name", "")),
        frames=counts.frames,
        measured=counts.measured,
        overflowed=counts.overflowed,
        evidence=counts.evidence,
        size_bytes=session.size_bytes,
        end=str(SessionEnd(counts.end)),
    )


def _plain(text: str) -> str:
    return " ".join(text.casefold().split())


def _select(library: sqlite3.Connection, query: Query) -> list[Entry]:
    conditions, values = ["1"], []
    for word in query.words:
        conditions.append("instr(said, ?)")
        values.append(_plain(word))
    if query.tube is not None:
        conditions.append("name IN (SELECT session FROM tubes WHERE instr(tube, ?))")
        values.append(_plain(query.tube))
    if query.since is not None:
        conditions.append("substr(started_utc, 1, 10) >= ?")
        values.append(query.since)
    if query.until is not None:
        conditions.append("substr(started_utc, 1, 10) <= ?")
        values.append(query.until)
    columns = ", ".join(COLUMNS)
    rows: list[tuple[Any, ...]] = library.execute(
        f"SELECT {columns} FROM sessions WHERE {' AND '.join(conditions)} ORDER BY name",  # noqa: S608 - no values in it
        values,
    ).fetchall()
    return [Entry(*row) for row in rows]
