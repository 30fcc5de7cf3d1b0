"""The index of a recorded session: every frame's exact times, check sum and place in the video; what was measured.

One line of checked JSON a record (see `checked_lines`), appended as things happen and never changed:

====================  ==============================================================================================
``session_index``     the first line: version of this form, SHA-256 of the session's description
``stream``            source, size and depth of the frames that follow
``frame``             a frame that was recorded
``outside``           what a result line of the frame measured next rests on besides it: by its time and field
``measured``          a recorded frame was measured, and what its lines in the result log are; null: it was lost here
``overflowed``        so many more frames that found no room in the recorder
``written``           how much of a video file there is by now, and the SHA-256 of that much
``finished``          a video file is complete, and its SHA-256
``evidence``          so many evidence records there are now, and the hash of the last
``closed``            the last line of a session that ended in order
====================  ==============================================================================================

What was measured stands in the order in which it was: to measure these frames again, and no others, gives the same.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from drivers.checked_lines import read_checked
from drivers.errors import UnsupportedFormatError
from drivers.frame import Field, PixelFormat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from drivers.frame import Pixels

__all__ = [
    "INDEX",
    "VIDEO",
    "Closed",
    "Evidence",
    "Fault",
    "Finished",
    "Header",
    "Item",
    "Measured",
    "Outside",
    "Overflow",
    "Row",
    "Stream",
    "Written",
    "measured_rows",
    "pixels_crc32",
    "read_index",
]

VERSION = 1
INDEX, VIDEO = "index.jsonl", "video"
"""Names of the index and of the folder of videos in a session's folder."""
VIDEO_NAME = re.compile(r"[0-9]{6}\.(mkv|nut)")


@dataclass(frozen=True, slots=True)
class Header:
    """The first line: what session this is the index of."""

    session_sha256: str

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {"session_index": VERSION, "session_sha256": self.session_sha256}


@dataclass(frozen=True, slots=True)
class Stream:
    """What the frames that follow have in common."""

    source: str
    size_px: tuple[int, int]
    pixel_format: PixelFormat

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {"stream": self.source, "size_px": list(self.size_px), "format": str(self.pixel_format)}


@dataclass(frozen=True, slots=True)
class Row:
    """A frame that was recorded.

    Attributes
    ----------
    number
        From 0 on, in the order of recording.
    sequence, generation, timestamp_ns, received_ns, field, defect
        The frame's own.
    wall_ns
        When it was received, by the system's clock, since 1970.
    crc32
        Of its pixels, row by row, 16-bit values low byte first.
    video, at, pts_us
        The video file, its place in there, and its presentation time.
    stream
        Source, size and depth.
    """

    number: int
    sequence: int | None
    generation: int
    timestamp_ns: int
    received_ns: int
    wall_ns: int
    field: Field
    defect: str | None
    crc32: int
    video: str
    at: int
    pts_us: int
    stream: Stream

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {
            "frame": self.number,
            "sequence": self.sequence,
            "generation": self.generation,
            "timestamp_ns": self.timestamp_ns,
            "received_ns": self.received_ns,
            "wall_ns": self.wall_ns,
            "field": str(self.field),
            "defect": self.defect,
            "crc32": f"{self.crc32:08x}",
            "video": self.video,
            "at": self.at,
            "pts_us": self.pts_us,
        }


@dataclass(frozen=True, slots=True)
class Outside:
    """What a result rests on besides frames and configuration: what the operator chose, what instruments said.

    Attributes
    ----------
    time_ns, field
        Of the result's picture.
    values
        See `docs/formats.md`.
    """

    time_ns: int
    field: str
    values: Mapping[str, Any]

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {"outside": self.time_ns, "field": self.field, **self.values}


@dataclass(frozen=True, slots=True)
class Measured:
    """A frame was measured.

    Attributes
    ----------
    number
        Which; None where the recorder lost the frame itself: nothing after it can be measured again exactly.
    lines_at, lines_bytes, lines_crc32
        Where its lines in the result log begin, how long they are with their line ends, and their check sum.
    """

    number: int | None
    lines_at: int
    lines_bytes: int
    lines_crc32: int

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {
            "measured": self.number,
            "at": self.lines_at,
            "bytes": self.lines_bytes,
            "crc32": f"{self.lines_crc32:08x}",
        }


@dataclass(frozen=True, slots=True)
class Overflow:
    """Frames that found no room in the recorder since the last line that told of some."""

    frames: int

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {"overflowed": self.frames}


@dataclass(frozen=True, slots=True)
class Written:
    """How much of a video file was written, and the SHA-256 of that: what holds where the recording is interrupted."""

    video: str
    size_bytes: int
    sha256: str

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {"written": self.video, "bytes": self.size_bytes, "sha256": self.sha256}


@dataclass(frozen=True, slots=True)
class Finished:
    """A video file that was written to its end."""

    video: str
    size_bytes: int
    sha256: str

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {"finished": self.video, "bytes": self.size_bytes, "sha256": self.sha256}


@dataclass(frozen=True, slots=True)
class Evidence:
    """How many evidence records there are, and the hash of the last."""

    records: int
    sha256: str

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {"evidence": self.records, "sha256": self.sha256}


@dataclass(frozen=True, slots=True)
class Closed:
    """The session's end, why, and what there was of it; `sha256` has files that have no other check."""

    wall_ns: int
    reason: str
    frames: int
    measured: int
    sha256: Mapping[str, str]

    def record(self) -> dict[str, Any]:
        """The line's values."""
        return {
            "closed": self.reason,
            "wall_ns": self.wall_ns,
            "frames": self.frames,
            "measured": self.measured,
            "sha256": dict(self.sha256),
        }


@dataclass(frozen=True, slots=True)
class Fault:
    """A line that says nothing that can be trusted, and why; `torn`: it is only unfinished."""

    line: int
    problem: str
    torn: bool = False


Item: TypeAlias = Header | Stream | Row | Outside | Measured | Overflow | Written | Finished | Evidence | Closed | Fault


def read_index(path: Path) -> Iterator[Item]:
    """Read an index, line by line, however long it is.

    Raises
    ------
    UnsupportedFormatError
        It cannot be read, is none, or is of a later version.
    """
    try:
        yield from _items(path)
    except OSError as error:
        raise UnsupportedFormatError(str(path), f"cannot be read: {error.strerror}; copy the session again") from error


def _items(path: Path) -> Iterator[Item]:
    stream: Stream | None = None
    for line in read_checked(path):
        if line.record is None:
            item: Item = Fault(line.number, line.problem or "", line.torn)
        else:
            try:
                item = _item(line.record, stream)
            except (KeyError, ValueError, TypeError) as error:
                item = Fault(line.number, f"is no record of version {VERSION}: {type(error).__name__}: {error}")
        if line.number == 1:
            _check_version(path, line.record, item)
        if isinstance(item, Stream):
            stream = item
        yield item


def _check_version(path: Path, record: Mapping[str, Any] | None, item: Item) -> None:
    version = None if record is None else record.get("session_index")
    if isinstance(version, int) and version > VERSION:
        raise UnsupportedFormatError(
            str(path), f"is of version {version}, this Bowlsight reads {VERSION}; use a later one"
        )
    if not isinstance(item, Header | Fault):
        raise UnsupportedFormatError(str(path), "does not begin as a session's index does; is it one?")


def _item(r: Mapping[str, Any], stream: Stream | None) -> Item:
    """The item that a line's values make; raises KeyError, ValueError or TypeError where they do not."""
    kind = next(iter(r))
    if kind == "frame":
        return _row(r, stream)
    if kind not in _READERS:
        raise ValueError(f"unknown record {kind!r}")
    return _READERS[kind](r)


def _row(r: Mapping[str, Any], stream: Stream | None) -> Row:
    if stream is None:
        raise ValueError("a frame before its stream")
    return Row(
        number=_whole(r["frame"]),
        sequence=None if r["sequence"] is None else _whole(r["sequence"]),
        generation=_whole(r["generation"]),
        timestamp_ns=_whole(r["timestamp_ns"]),
        received_ns=_whole(r["received_ns"]),
        wall_ns=_whole(r["wall_ns"]),
        field=Field(r["field"]),
        defect=None if r["defect"] is None else _text(r["defect"]),
        crc32=int(r["crc32"], 16),
        video=_video(r["video"]),
        at=_whole(r["at"]),
        pts_us=_whole(r["pts_us"]),
        stream=stream,
    )


def _whole(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{value!r} is no whole number")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value


def _video(value: object) -> str:
    """The name of a video file; nothing that leads out of the session's folder."""
    name = _text(value)
    if VIDEO_NAME.fullmatch(name) is None:
        raise ValueError(f"{name!r} is no video of a session")
    return name


def _stream(r: Mapping[str, Any]) -> Stream:
    width, height = r["size_px"]
    return Stream(_text(r["stream"]), (_whole(width), _whole(height)), PixelFormat(r["format"]))


def _measured(r: Mapping[str, Any]) -> Measured:
    number = None if r["measured"] is None else _whole(r["measured"])
    return Measured(number, _whole(r["at"]), _whole(r["bytes"]), int(r["crc32"], 16))


def _closed(r: Mapping[str, Any]) -> Closed:
    sha256 = {_text(name): _text(digest) for name, digest in r["sha256"].items()}
    return Closed(_whole(r["wall_ns"]), _text(r["closed"]), _whole(r["frames"]), _whole(r["measured"]), sha256)


_READERS: Final[Mapping[str, Callable[[Mapping[str, Any]], Item]]] = {
    "session_index": lambda r: Header(_text(r["session_sha256"])),
    "stream": _stream,
    "measured": _measured,
    "outside": lambda r: Outside(
        _whole(r["outside"]), _text(r["field"]), {k: v for k, v in r.items() if k not in ("outside", "field")}
    ),
    "overflowed": lambda r: Overflow(_whole(r["overflowed"])),
    "written": lambda r: Written(_video(r["written"]), _whole(r["bytes"]), _text(r["sha256"])),
    "finished": lambda r: Finished(_video(r["finished"]), _whole(r["bytes"]), _text(r["sha256"])),
    "evidence": lambda r: Evidence(_whole(r["evidence"]), _text(r["sha256"])),
    "closed": _closed,
}


def measured_rows(items: Iterable[Item]) -> Iterator[Row]:
    """The frames that were measured, in the order in which they were."""
    waiting: dict[int, Row] = {}
    for item in items:
        if isinstance(item, Row):
            waiting[item.number] = item
        elif isinstance(item, Measured) and item.number is not None:
            row = waiting.get(item.number)
            for passed in [number for number in waiting if number <= item.number]:
                del waiting[passed]
            if row is not None:
                yield row


def pixels_crc32(pixels: Pixels) -> int:
    """Check sum of a picture, as `Row.crc32`."""
    return zlib.crc32(pixels.data)
