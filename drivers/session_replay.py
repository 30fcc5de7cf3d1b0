"""A recorded session through the grabber interface: the frames that were measured, as they were, in their order."""

from __future__ import annotations

import itertools
import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from drivers.errors import DeviceNotFoundError, UnsupportedFormatError
from drivers.frame import Field
from drivers.grabber import FrameFormat
from drivers.recordings import Picture, Recording, blank
from drivers.replay import ReplayGrabber
from drivers.session_index import INDEX, VIDEO, Fault, measured_rows, pixels_crc32, read_index
from drivers.session_video import PictureLostError, SessionVideo

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator
    from pathlib import Path

    from drivers.frame import Frame, Pixels
    from drivers.session_index import Item, Row

__all__ = ["SessionGrabber", "SessionRecording", "is_session", "recorded_pixels"]

log = logging.getLogger(__name__)

RATED_ROWS = 100
ASSUMED_PERIOD_NS = 40_000_000
LONGEST_WAIT_NS = 5_000_000_000
"""Where nothing came for longer, that is what replay waits."""


def is_session(path: Path) -> bool:
    """Whether a path is the folder of a recorded session."""
    return (path / INDEX).is_file()


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPicture(Picture):
    """A picture, and what the index says of it."""

    row: Row | None = None


class SessionRecording(Recording):
    """The frames of a session that were measured.

    A frame whose picture is damaged, or missing amid the others, is blank and has a defect. Frames at the end that
    never reached the video, because the recording was interrupted, are left out, and that is logged.

    Raises
    ------
    DeviceNotFoundError
        There is no such session.
    UnsupportedFormatError
        Its index cannot be read, or has no measured frame.
    """

    def __init__(self, folder: Path, *, name: str) -> None:
        self.name, self._folder = name, folder
        self.frame_count = None
        if not is_session(folder):
            raise DeviceNotFoundError(name, f"is no recorded session: it has no {INDEX}; check the path")
        first = list(itertools.islice(self._rows(quiet=True), RATED_ROWS))
        if not first:
            raise UnsupportedFormatError(name, "has no measured frame: nothing can be replayed")
        steps = sorted(b.timestamp_ns - a.timestamp_ns for a, b in itertools.pairwise(first))
        self.period_ns = max(1, steps[len(steps) // 2]) if steps else ASSUMED_PERIOD_NS
        self.first_row = first[0]
        stream = self.first_row.stream
        self.format = FrameFormat(
            *stream.size_px, stream.pixel_format, "session", 1e9 / self.period_ns, self.first_row.field
        )

    def _rows(self, *, quiet: bool = False) -> Iterator[Row]:
        items = read_index(self._folder / INDEX)
        return measured_rows(items if quiet else self._telling(items))

    def _telling(self, items: Iterable[Item]) -> Iterator[Item]:
        for item in items:
            if isinstance(item, Fault):
                log.warning("%s: %s line %d %s; left out", self.name, INDEX, item.line, item.problem)
            yield item

    def pictures(self) -> Generator[Picture]:
        """Play from the beginning."""
        before_ns, time_ns = self.first_row.timestamp_ns, 0
        for row, pixels, fault in recorded_pixels(self._folder, self._rows(), self.name):
            time_ns += min(max(0, row.timestamp_ns - before_ns), LONGEST_WAIT_NS)
            before_ns = row.timestamp_ns
            number = row.number if row.sequence is None else row.sequence
            yield RecordedPicture(number, time_ns, pixels, fault or row.defect, row)


def recorded_pixels(folder: Path, rows: Iterable[Row], name: str) -> Iterator[tuple[Row, Pixels, str | None]]:
    """Decode the pictures of rows in their order: pixels, and None or what is wrong with them.

    Rows at the end without a picture are left out: the recording was interrupted. That is logged as `name`'s.
    """
    video: SessionVideo | None = None
    opened, why = "", ""
    missing: list[tuple[Row, str]] = []
    try:
        for row in rows:
            if row.video != opened:
                if video is not None:
                    video.close()
                video, why = _opened(folder, row.video)
                opened = row.video
            try:
                if video is None:
                    raise PictureLostError(why)  # noqa: TRY301 - said once, for the file as for its pictures
                pixels = video.read(row.pts_us)
            except PictureLostError as lost:
                missing.append((row, str(lost)))
                continue
            yield from _blanks(missing)
            missing = []
            yield row, pixels, _mismatch(row, pixels)
    finally:
        if video is not None:
            video.close()
    if missing:
        log.warning("%s: the last %d frames are left out: %s", name, len(missing), missing[0][1])


def _opened(folder: Path, video: str) -> tuple[SessionVideo | None, str]:
    try:
        return SessionVideo(folder / VIDEO / video), ""
    except PictureLostError as error:
        return None, str(error)


def _blanks(missing: Iterable[tuple[Row, str]]) -> Iterator[tuple[Row, Pixels, str | None]]:
    for row, why in missing:
        yield row, blank(FrameFormat(*row.stream.size_px, row.stream.pixel_format, "session")), why


def _mismatch(row: Row, pixels: Pixels) -> str | None:
    height, width = pixels.shape
    if (width, height) != row.stream.size_px or pixels_crc32(pixels) != row.crc32:
        return f"video {row.video} is damaged: the picture at {row.pts_us / 1e6:.3f} s is not the one recorded"
    return None


class SessionGrabber(ReplayGrabber):
    """Plays a recorded session: frames have the source, numbers, times and fields that they had.

    Frames that were not measured then are passed over, and count as lost. `generation` is the one recorded; from the
    second `open` on it goes on growing. Paused and started again, numbers begin anew as with any grabber.

    Parameters
    ----------
    path
        The session's folder.
    speed, loop, name, clock
        As in `ReplayGrabber`.
    """

    _offset = 0
    _current = 0

    def _find(self) -> SessionRecording:
        recording = SessionRecording(self._path, name=self.name)
        self._offset = self._current
        self._current += recording.first_row.generation
        return recording

    @property
    def generation(self) -> int:
        """That of the last frame, or of the first one to come."""
        return self._current

    @property
    def format(self) -> FrameFormat:
        """The format of the first frame."""
        granted = super().format
        return replace(granted, field=self._opened().format.field) if granted.field is Field.UNKNOWN else granted

    def _frame(self, picture: Picture, time_ns: int, sequence: int) -> Frame:
        frame = super()._frame(picture, time_ns, sequence)
        row = picture.row if isinstance(picture, RecordedPicture) else None
        assert row is not None, "pictures of a session"
        self._current = self._offset + row.generation
        return replace(
            frame,
            sequence=None if row.sequence is None else sequence,
            timestamp_ns=row.timestamp_ns + time_ns - picture.time_ns,
            field=row.field,
            source=row.stream.source,
            generation=self._current,
        )
