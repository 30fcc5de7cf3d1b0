"""The files of one session, written as things happen, by one thread."""

from __future__ import annotations

import hashlib
import zlib
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any

import av

from drivers.checked_lines import LineChecker
from drivers.session_index import (
    INDEX,
    VIDEO,
    Closed,
    Evidence,
    Header,
    Measured,
    Outside,
    Overflow,
    Row,
    Stream,
    pixels_crc32,
)
from service.sinks.session.about import file_sha256, write_about
from service.sinks.session.memory import Memory
from service.sinks.session.places import CSV, EVENTS, MEMORY, RESULTS, VIEWER, SessionLock
from service.sinks.session.surroundings import utc_text
from service.sinks.session.video import HashedFile, VideoFiles
from service.sinks.table import CsvWriter
from service.sinks.textfile import LineFile

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.sinks.session.about import SessionAbout
    from service.sinks.session.video import Output

__all__ = ["CheckedFile", "SessionWriter"]

NAMES_EVERY_NS = WITNESS_EVERY_NS = 1_000_000_000


class CheckedFile:
    """A file of checked lines; a line that finds no room is as if it had never been."""

    def __init__(self, path: Path) -> None:
        self._file, self._checker = LineFile(path), LineChecker()
        self._file.open()

    def append(self, record: Mapping[str, Any]) -> None:
        """Append a line; raises OSError where there is no room for it."""
        before = self._checker.check
        try:
            self._file.write(self._checker.line(record))
        except OSError:
            self._checker.check = before
            raise

    def close(self) -> None:
        """Close it. May be repeated."""
        self._file.close()


class FollowedFile:
    """The hash of a file that somebody else appends to, read as it grows so that its end takes no time."""

    def __init__(self, path: Path) -> None:
        self._path, self._hash, self._at = path, hashlib.sha256(), 0

    def follow(self) -> None:
        """Read what was appended."""
        with self._path.open("rb") as file:
            file.seek(self._at)
            while block := file.read(1 << 20):
                self._hash.update(block)
                self._at += len(block)

    def sha256(self) -> str:
        """Of all that is there."""
        self.follow()
        return self._hash.hexdigest()


class SessionWriter:
    """Writes a session into its folder, which is there and has its configuration.

    Every call but the constructor, `close` and `abort` raises OSError, or FFmpeg's error, where there is no room.

    Parameters
    ----------
    folder
        The session's.
    about
        Its description.
    csv
        Whether results are written for spreadsheets as well.
    wall_ns
        UTC.
    open_video
        Opens video files.

    Raises
    ------
    OSError, ConfigError
        The files cannot be made.
    """

    def __init__(
        self,
        folder: Path,
        about: SessionAbout,
        *,
        csv: bool,
        wall_ns: Callable[[], int],
        open_video: Callable[[Path], Output] = HashedFile,
    ) -> None:
        self.folder, self._wall_ns = folder, wall_ns
        self.frames = self.measured = self.overflowed = 0
        self._results_bytes = 0
        self._viewer: FollowedFile | None = None
        self._stream: Stream | None = None
        self._memory_sha256: str | None = None
        self._names: set[str] = set()
        self._new_names: list[str] = []
        self._named_ns: int | None = None
        self._witnessed_ns: int | None = None
        with ExitStack() as opened:
            self._lock = SessionLock(folder)
            opened.callback(self._lock.release)
            self.sha256 = write_about(folder, about)
            (folder / VIDEO).mkdir()
            self._video = VideoFiles(folder / VIDEO, open_video)
            self._index = CheckedFile(folder / INDEX)
            opened.callback(self._index.close)
            self._events = CheckedFile(folder / EVENTS)
            opened.callback(self._events.close)
            self._results = LineFile(folder / RESULTS)
            self._results.open()
            opened.callback(self._results.close)
            self._csv = CsvWriter(folder / CSV) if csv else None
            if self._csv is not None:
                self._csv.start()
                opened.callback(self._csv.close, 0.0)
            self._index.append(Header(self.sha256).record())
            self._open = opened.pop_all()

    def record(self, frame: Frame, wall_ns: int) -> int:
        """Append a frame, received at that UTC, to video and index; gives its number in the session."""
        stream = Stream(frame.source, frame.size_px, frame.pixel_format)
        if stream != self._stream:
            self._index.append(stream.record())
            self._stream = stream
        video, at, pts_us = self._video.write(frame)
        self._note_finished()
        row = Row(
            number=self.frames,
            sequence=frame.sequence,
            generation=frame.generation,
            timestamp_ns=frame.timestamp_ns,
            received_ns=frame.received_ns,
            wall_ns=wall_ns,
            field=frame.field,
            defect=frame.defect,
            crc32=pixels_crc32(frame.pixels),
            video=video,
            at=at,
            pts_us=pts_us,
            stream=stream,
        )
        self._index.append(row.record())
        self.frames += 1
        self._witness(frame.received_ns)
        return row.number

    def _witness(self, now_ns: int) -> None:
        """Put into the index, once a second, what the video holds by now."""
        if self._witnessed_ns is None:
            self._witnessed_ns = now_ns
        elif now_ns - self._witnessed_ns >= WITNESS_EVERY_NS and (written := self._video.written) is not None:
            self._witnessed_ns = now_ns
            self._index.append(written.record())

    def _note_finished(self) -> None:
        while self._video.finished:
            self._index.append(self._video.finished.pop(0).record())

    def remember(self, memory: Memory) -> None:
        """Write what measuring remembered before the first frame; its hash goes into the index with the next answer."""
        if memory.tree:
            data = memory.to_bytes()
            (self.folder / MEMORY).write_bytes(data)
            self._memory_sha256 = Memory.sha256(data)

    def answer(self, number: int | None, results: Sequence[FrameResult]) -> None:
        """Append a measured frame's results; `number` is None where the frame itself was lost here."""
        lines = [result.to_json() for result in results]
        for line in lines:
            self._results.write(line)
        for result in results:
            outside = dict(result.outside or {})
            if self._memory_sha256 is not None:
                outside["memory"], self._memory_sha256 = self._memory_sha256, None
            if outside:
                m = result.measurement
                self._index.append(Outside(m.time_ns, m.field, outside).record())
        text = "".join(f"{line}\n" for line in lines).encode("ascii")
        self._index.append(Measured(number, self._results_bytes, len(text), zlib.crc32(text)).record())
        self._results_bytes += len(text)
        self.measured += 1
        if self._csv is not None:
            self._csv.write(results)
        self._collect_names(results)

    def _collect_names(self, results: Sequence[FrameResult]) -> None:
        """Note tubes named for the first time, once a second."""
        for result in results:
            new = sorted({name for name in result.names if name is not None} - self._names)
            self._names.update(new)
            self._new_names += new
        now_ns = self._wall_ns()
        due = self._named_ns is None or not 0 <= now_ns - self._named_ns < NAMES_EVERY_NS
        if self._new_names and due:
            self._flush_names()
            self._named_ns = now_ns

    def _flush_names(self) -> None:
        if self._new_names:
            self.event("tubes", f"{len(self._new_names)} tubes named for the first time", names=self._new_names)
            self._new_names = []

    def follow_viewer(self) -> None:
        """Read what was appended to the viewer's file; from the first call on, its hash is part of the session."""
        if self._viewer is None:
            self._viewer = FollowedFile(self.folder / VIEWER)
        self._viewer.follow()

    def forget_viewer(self) -> None:
        """Leave the viewer's file out of what is vouched for: somebody may still write to it."""
        self._viewer = None

    def overflow(self, frames: int) -> None:
        """Note frames that were not recorded for want of room in the queue."""
        self.overflowed += frames
        self._index.append(Overflow(frames).record())

    def evidence(self, records: int, sha256: str) -> None:
        """Note how far the evidence log has got."""
        self._index.append(Evidence(records, sha256).record())

    def event(self, kind: str, text: str, level: str = "INFO", **more: object) -> None:
        """Append an event: what kind, in words, how grave, and what else is to be known."""
        self._events.append(
            {"utc": utc_text(self._wall_ns()), "kind": kind, "level": level, "text": text, "frame": self.frames, **more}
        )

    def close(self, reason: str) -> None:
        """Write the ends of all files; raises as the other calls do, with everything closed all the same."""
        with self._open:
            try:
                self._video.close()
                self._note_finished()
            except (OSError, av.FFmpegError):
                self._video.abort()
                raise
            self._flush_names()
            self.event("closed", reason)
            hashes = self._hashes()
            self._index.append(Closed(self._wall_ns(), reason, self.frames, self.measured, hashes).record())

    def _hashes(self) -> dict[str, str]:
        """Of files that nothing else checks, or whose last lines nothing would miss."""
        names = [EVENTS, *([] if self._csv is None else [CSV])]
        viewer = {} if self._viewer is None else {VIEWER: self._viewer.sha256()}
        return {name: file_sha256(self.folder / name) for name in names} | viewer

    def abort(self, reason: str) -> None:
        """Let everything go as it is, after an error; the reason is written down where there is room for that."""
        with self._open:
            self._video.abort()
            with suppress(OSError):
                self.event("failed", reason, "ERROR")
