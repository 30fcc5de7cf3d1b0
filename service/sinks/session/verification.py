"""Whether a session's folder is as it was written: every byte of it, and what is wrong is named."""

from __future__ import annotations

import hashlib
import io
import zlib
from typing import IO, TYPE_CHECKING

from drivers.checked_lines import read_checked
from drivers.errors import ConfigError, UnsupportedFormatError
from drivers.session_index import (
    INDEX,
    VIDEO,
    Closed,
    Evidence,
    Fault,
    Finished,
    Header,
    Measured,
    Outside,
    Row,
    Written,
)
from drivers.session_index import read_index as read_items
from drivers.session_replay import recorded_pixels
from service.sinks.evidence_check import EvidenceCheck
from service.sinks.session.about import file_sha256, read_about
from service.sinks.session.configuration import joint_sha256
from service.sinks.session.finding import Finding
from service.sinks.session.places import (
    ABOUT,
    CONFIG,
    CSV,
    EVENTS,
    EVIDENCE,
    LOCK,
    MEMORY,
    RESULTS,
    VIEWER,
    is_running,
)  # fmt: skip

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from drivers.session_index import Item

__all__ = ["verify_session"]

BLOCK_BYTES = 1 << 20
KNOWN = {ABOUT, INDEX, EVENTS, RESULTS, CSV, VIEWER, LOCK, MEMORY, CONFIG, VIDEO, EVIDENCE}


def verify_session(
    folder: Path, *, videos: bool = True, progress: Callable[[int, int], None] = lambda _done, _total: None
) -> Iterator[Finding]:
    """Check a session's folder against its own hashes and check sums; nothing is given where all is well.

    Parameters
    ----------
    folder
        The session's.
    videos
        Whether to read the video files too, which takes as long as the disk needs for all of them.
    progress
        Told how many bytes of the results, and of the video where that is read, were read, and how many there are.
    """
    yield from _Verification(folder, progress).findings(videos=videos)


class _Verification:
    """One pass over a session of any length; what is kept grows with its files and its evidence alone."""

    def __init__(self, folder: Path, progress: Callable[[int, int], None]) -> None:
        self._folder, self._progress = folder, progress
        self._header: Header | None = None
        self._closed: Closed | None = None
        self._memory: str | None = None
        self._videos: dict[str, Finished | Written | None] = {}
        self._evidence = EvidenceCheck(folder)
        self._frames = self._measured = self._results_end = 0
        self._done = self._total = 0

    def findings(self, *, videos: bool) -> Iterator[Finding]:
        to_read = [self._folder / RESULTS, *((self._folder / VIDEO).glob("*") if videos else ())]
        self._total = sum(map(_size, to_read))
        yield from self._index()
        yield from self._end()
        yield from self._about()
        for name, recorded in (self._closed.sha256 if self._closed is not None else {}).items():
            yield from _hashed(self._folder, name, recorded)
        if self._memory is not None:
            yield from _hashed(self._folder, MEMORY, self._memory)
        yield from self._events()
        for name, said in self._videos.items() if videos else ():
            yield from self._video(name, said)
            self._done += _size(self._folder / VIDEO / name)
            self._progress(self._done, self._total)
        yield from _strays(self._folder / VIDEO, set(self._videos), VIDEO)
        genesis = None if self._header is None else self._header.session_sha256
        yield from self._evidence.findings(genesis, closed=self._closed is not None)
        for path in sorted(self._folder.iterdir()):
            if path.name not in KNOWN:
                yield Finding(path.name, "is no part of a session", grave=False)

    def _index(self) -> Iterator[Finding]:
        """Read the index, and the result log along with it."""
        try:
            with (self._folder / RESULTS).open("rb") as results:
                self._done = results.seek(0, io.SEEK_END)
                for item in read_items(self._folder / INDEX):
                    if isinstance(item, Fault):
                        yield Finding(INDEX, f"line {item.line} {item.problem}", grave=not item.torn)
                    elif isinstance(item, Measured):
                        yield from self._lines(item, results)
                        self._progress(self._results_end, self._total)
                    else:
                        self._take(item)
                results.seek(self._results_end)
                if results.read(1):
                    closed = self._closed is not None
                    yield Finding(RESULTS, f"goes on after byte {self._results_end}, where it ends", grave=closed)
        except UnsupportedFormatError as error:
            yield Finding(INDEX, error.message)
        except OSError as error:
            yield Finding(RESULTS, f"cannot be read: {error.strerror}")

    def _take(self, item: Item) -> None:
        match item:
            case Header():
                self._header = item
            case Row():
                self._frames += 1
                self._videos.setdefault(item.video)
                self._evidence.frame(item)
            case Finished() | Written():
                self._videos[item.video] = item
            case Evidence():
                self._evidence.witnessed.append(item)
            case Closed():
                self._closed = item
            case Outside():
                self._memory = item.values.get("memory", self._memory)
            case _:
                pass

    def _lines(self, item: Measured, results: IO[bytes]) -> Iterator[Finding]:
        """Check the result lines of one frame."""
        self._measured += 1
        self._results_end = item.lines_at + item.lines_bytes
        results.seek(item.lines_at)
        text = results.read(item.lines_bytes)
        if len(text) < item.lines_bytes or zlib.crc32(text) != item.lines_crc32:
            yield Finding(RESULTS, f"the lines of frame {item.number}, from byte {item.lines_at} on, were changed")
        else:
            self._evidence.lines(item.number, text)

    def _end(self) -> Iterator[Finding]:
        if self._closed is None:
            running = is_running(self._folder)
            text = "is still being recorded" if running else "was interrupted: it was not closed in order"
            yield Finding(INDEX, text, grave=False)
        elif (self._closed.frames, self._closed.measured) != (self._frames, self._measured):
            there = f"{self._frames} frames, {self._measured} measured"
            yield Finding(INDEX, f"has {there}; it had {self._closed.frames}, {self._closed.measured} measured")

    def _about(self) -> Iterator[Finding]:
        """Check the description and the configuration."""
        folder = self._folder
        try:
            digest = file_sha256(folder / ABOUT)
            if self._header is None:
                yield Finding(ABOUT, f"cannot be checked: the first line of {INDEX}, which has its hash, was changed")
            elif digest != self._header.session_sha256:
                yield Finding(ABOUT, "was changed: its hash is not the one in the index")
                return
            about = read_about(folder)
        except OSError as error:
            yield Finding(ABOUT, f"cannot be read: {error.strerror}")
        except ConfigError as error:
            yield Finding(ABOUT, f"was changed: {error}")
        else:
            for name, recorded in about.files.items():
                yield from _hashed(folder, f"{CONFIG}/{name}", recorded)
            if joint_sha256(about.files) != about.configuration_sha256:
                yield Finding(ABOUT, "configuration_sha256 is not that of its files")
            yield from _strays(folder / CONFIG, set(about.files), CONFIG)

    def _events(self) -> Iterator[Finding]:
        try:
            for line in read_checked(self._folder / EVENTS):
                if line.problem is not None:
                    grave = self._closed is not None or not line.torn
                    yield Finding(EVENTS, f"line {line.number} {line.problem}", grave=grave)
        except OSError as error:
            yield Finding(EVENTS, f"cannot be read: {error.strerror}")

    def _video(self, name: str, said: Finished | Written | None) -> Iterator[Finding]:
        path = self._folder / VIDEO / name
        try:
            whole = (
                said is None or _sha256(path, None if isinstance(said, Finished) else said.size_bytes) == said.sha256
            )
        except OSError as error:
            yield Finding(f"{VIDEO}/{name}", f"cannot be read: {error.strerror}")
            return
        if not whole:
            yield Finding(f"{VIDEO}/{name}", "was changed: its hash is not the one in the index")
        if not whole or not isinstance(said, Finished):
            yield from self._pictures(name)

    def _pictures(self, name: str) -> Iterator[Finding]:
        """Name the pictures of a video that are not those recorded."""
        rows = [i for i in read_items(self._folder / INDEX) if isinstance(i, Row) and i.video == name]
        seen = 0
        for row, _, problem in recorded_pixels(self._folder, rows, self._folder.name):
            seen += 1
            if problem is not None:
                yield Finding(f"{VIDEO}/{name}", f"frame {row.number}: {problem}")
        if seen < len(rows):
            text = f"ends before its last {len(rows) - seen} frames, which were still to be written"
            yield Finding(f"{VIDEO}/{name}", text, grave=False)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # reading it will tell
        return 0


def _hashed(folder: Path, name: str, recorded: str) -> Iterator[Finding]:
    try:
        if file_sha256(folder / name) != recorded:
            yield Finding(name, "was changed: its hash is not the one recorded")
    except OSError as error:
        yield Finding(name, f"cannot be read: {error.strerror}")


def _strays(folder: Path, names: set[str], shown: str) -> Iterator[Finding]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and (name := str(path.relative_to(folder))) not in names:
            yield Finding(f"{shown}/{name}", "is no part of the session", grave=False)


def _sha256(path: Path, size_bytes: int | None) -> str:
    """SHA-256 of a file, or of its beginning."""
    if size_bytes is None:
        return file_sha256(path)
    digest, left = hashlib.sha256(), size_bytes
    with path.open("rb") as file:
        while left and (block := file.read(min(left, BLOCK_BYTES))):
            digest.update(block)
            left -= len(block)
    return digest.hexdigest()
