"""The one place to open a recorded session: whole, interrupted, damaged, or still being recorded."""

from __future__ import annotations

import enum
import itertools
import json
import zlib
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.checked_lines import read_checked
from drivers.errors import ConfigError
from drivers.session_index import INDEX, Closed, Evidence, Fault, Header, Measured, Outside, Overflow, Row, read_index
from drivers.session_replay import recorded_pixels
from service.sinks.evidence import RECORDS, read_records
from service.sinks.session.about import file_sha256, read_about, unknown_about
from service.sinks.session.memory import Memory
from service.sinks.session.places import (
    ABOUT,
    CONFIG,
    EVENTS,
    EVIDENCE,
    MEMORY,
    RESULTS,
    STATION,
    is_running,
    size_bytes,
)  # fmt: skip

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from drivers.frame import Pixels
    from drivers.session_index import Item
    from service.sinks.evidence import EvidenceRecord
    from service.sinks.session.about import SessionAbout

__all__ = ["Answered", "RecordedSession", "SessionCounts", "SessionEnd", "open_session"]


class SessionEnd(enum.StrEnum):
    """How a session ended."""

    CLOSED = "closed"
    RECORDING = "recording"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True)
class SessionCounts:
    """What there is in a session, by its index.

    Attributes
    ----------
    frames, measured, evidence
        Frames recorded, frames measured, evidence records.
    overflowed
        Frames that found no room in the recorder.
    began_ns, ended_ns
        UTC of the first and the last frame, since 1970; None without a frame.
    faults
        Lines of the index that say nothing that can be trusted; one that is torn off at the end is none.
    end, reason
        How it ended, and why.
    """

    frames: int
    measured: int
    evidence: int
    overflowed: int
    began_ns: int | None
    ended_ns: int | None
    faults: int
    end: SessionEnd
    reason: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Answered:
    """What the result log says of one measured frame.

    Attributes
    ----------
    row
        The frame as it was recorded; None where the recorder lost it.
    lines
        Its result lines as they were written, one, or two for interlaced video; see `docs/formats.md`.
    problem
        None, or in words what is wrong with these lines; then there are none.
    last_of_index
        Whether an anchor set here began the lattice index anew: after it, places are those of other tubes.
    """

    row: Row | None
    lines: Sequence[Mapping[str, Any]]
    problem: str | None = None
    last_of_index: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RecordedSession:
    """A session's folder, opened by `open_session`. Nothing of it is held in memory but its description.

    Attributes
    ----------
    folder
        Where it is.
    about
        Its description.
    damage
        Why that cannot be read, where it cannot: then it has what can be told without.
    """

    folder: Path
    about: SessionAbout
    damage: str | None = None

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    @property
    def started_ns(self) -> int:
        """When recording began, UTC since 1970."""
        return round(datetime.fromisoformat(self.about.started_utc).timestamp() * 1e3) * 1_000_000

    @property
    def station(self) -> Path:
        """The station file that it was recorded with, with all that it names beside it."""
        return self.folder / CONFIG / STATION

    @property
    def size_bytes(self) -> int:
        """What the folder takes."""
        return size_bytes(self.folder)

    def index(self) -> Iterator[Item]:
        """All that happened, in its order; raises UnsupportedFormatError where the index cannot be read."""
        return read_index(self.folder / INDEX)

    def counts(self) -> SessionCounts:
        """Count what there is."""
        frames = measured = evidence = overflowed = faults = 0
        began_ns = ended_ns = reason = None
        for item in self.index():
            match item:
                case Row():
                    frames, began_ns, ended_ns = frames + 1, began_ns or item.wall_ns, item.wall_ns
                case Measured(number=int()):
                    measured += 1
                case Overflow():
                    overflowed += item.frames
                case Evidence():
                    evidence = item.records
                case Closed():
                    reason = item.reason
                case Fault():
                    faults += not item.torn
                case _:
                    pass
        closed = SessionEnd.RECORDING if is_running(self.folder) else SessionEnd.INTERRUPTED
        end = closed if reason is None else SessionEnd.CLOSED
        return SessionCounts(frames, measured, evidence, overflowed, began_ns, ended_ns, faults, end, reason)

    def memory(self) -> dict[str, Any] | None:
        """What measuring remembered before the first frame that it measured; None where it began with the session.

        Raises
        ------
        ConfigError
            It was changed, or is of another version.
        """
        until_first = itertools.takewhile(lambda item: not isinstance(item, Measured), self.index())
        said = [i.values["memory"] for i in until_first if isinstance(i, Outside) and "memory" in i.values]
        if not said:
            return None
        try:
            data = (self.folder / MEMORY).read_bytes()
        except OSError as error:
            raise ConfigError(f"{self.folder / MEMORY}: cannot be read: {error.strerror}") from None
        if Memory.sha256(data) != said[0]:
            raise ConfigError(f"{self.folder / MEMORY}: was changed: its hash is not the one in the index")
        return Memory.from_bytes(data).values()

    def answers(self) -> Iterator[Answered]:
        """Give every measured frame with its results, in the order of measuring."""
        rows: dict[int, Row] = {}
        last_of_index = False
        with (self.folder / RESULTS).open("rb") as log:
            for item in self.index():
                if isinstance(item, Row):
                    rows[item.number] = item
                elif isinstance(item, Outside):
                    last_of_index = last_of_index or "begins_anew" in item.values
                elif isinstance(item, Measured):
                    row = None if item.number is None else rows.get(item.number)
                    rows = {number: r for number, r in rows.items() if item.number is None or number > item.number}
                    log.seek(item.lines_at)
                    yield replace(_answered(row, log.read(item.lines_bytes), item), last_of_index=last_of_index)
                    last_of_index = False

    def results(self) -> Iterator[Mapping[str, Any]]:
        """Give all result lines that are sound."""
        for answered in self.answers():
            yield from answered.lines

    def events(self) -> Iterator[Mapping[str, Any]]:
        """Give what happened, in words: utc, kind, level (INFO, WARN, ERROR), text, frame, and more by kind."""
        if (self.folder / EVENTS).is_file():
            for line in read_checked(self.folder / EVENTS):
                if line.record is not None:
                    yield line.record

    def evidence(self) -> Iterator[EvidenceRecord]:
        """Give the evidence records that are sound; whether all are, `verify_session` says."""
        folder = self.folder / EVIDENCE
        if (folder / RECORDS).is_file():
            first = next(self.index(), None)
            genesis = first.session_sha256 if isinstance(first, Header) else file_sha256(self.folder / ABOUT)
            for _, record, problem in read_records(folder, genesis):
                if record is not None and problem is None:
                    yield record

    def evidence_picture(self, record: EvidenceRecord) -> Path:
        """Where a record's picture is, a PNG file."""
        return self.folder / EVIDENCE / Path(str(record.values["picture"])).name

    def pictures(self, rows: Iterable[Row]) -> Iterator[tuple[Row, Pixels, str | None]]:
        """Decode recorded pictures, rows in their order; with each, None or what is wrong with it."""
        return recorded_pixels(self.folder, rows, self.name)


def _answered(row: Row | None, text: bytes, measured: Measured) -> Answered:
    if len(text) != measured.lines_bytes or zlib.crc32(text) != measured.lines_crc32:
        return Answered(row, (), "the result lines were changed, or cut short")
    return Answered(row, [json.loads(line) for line in text.splitlines()])


def open_session(path: Path, *, damaged: bool = False) -> RecordedSession:
    """Open a session's folder.

    Parameters
    ----------
    damaged
        Open it without its description too, where that cannot be read.

    Raises
    ------
    ConfigError
        It is none, or its description or index cannot be read.
    UnsupportedFormatError
        It is of a later version.
    """
    if not (path / INDEX).is_file():
        raise ConfigError(
            f"{path}: is no recorded session: it has no {INDEX}; bowlsight sessions lists those there are"
        )
    first = next(read_index(path / INDEX), None)
    if not isinstance(first, Header | Fault):
        raise ConfigError(f"{path / INDEX}: is empty: the recording was interrupted before it began")
    try:
        return RecordedSession(path, read_about(path))
    except ConfigError as error:
        if not damaged:
            raise
        frame = next((item for item in read_index(path / INDEX) if isinstance(item, Row)), None)
        return RecordedSession(path, unknown_about(path, 0 if frame is None else frame.wall_ns), str(error))
