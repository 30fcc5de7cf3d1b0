"""A session's frames as lossless video, in files of a minute, whole up to the last frame whenever they are cut off.

FFV1 in Matroska up to 640x480; above, and for 16 bit, where FFV1 takes too long, ffvhuff in NUT. Both are written like
to a pipe, each frame at once and nothing ever changed, so a file that was cut short is like the others but shorter.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from fractions import Fraction
from typing import TYPE_CHECKING, Final, Protocol

import av

from drivers.frame import PixelFormat
from drivers.session_index import Finished, Written

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from av.video.stream import VideoStream

    from drivers.frame import Frame

__all__ = ["HashedFile", "Output", "VideoFiles"]

FILE_NS: Final = 60_000_000_000
SMALL_PX = 640 * 480
BUFFER_BYTES = 1 << 20
PIXEL_FORMATS: Final = {PixelFormat.MONO8: "gray", PixelFormat.MONO16: "gray16le"}


class Output(Protocol):
    """A file that is only ever appended to."""

    def write(self, data: bytes) -> int:
        """Append all of it; raises OSError where it finds no room."""
        ...

    def close(self) -> None:
        """Close it. May be repeated."""
        ...

    @property
    def size_bytes(self) -> int:
        """What was written."""
        ...

    @property
    def sha256(self) -> str:
        """Of what was written."""
        ...


class HashedFile:
    """A new file, hashed as it is written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle: int | None = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._hash = hashlib.sha256()
        self.size_bytes = 0

    def write(self, data: bytes) -> int:
        """Append all of it; raises OSError where it finds no room."""
        assert self._handle is not None, "open"
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._handle, rest) :]
        except OSError as error:
            error.filename = str(self._path)
            raise
        self._hash.update(data)
        self.size_bytes += len(data)
        return len(data)

    @property
    def sha256(self) -> str:
        """Of what was written."""
        return self._hash.hexdigest()

    def close(self) -> None:
        """Close it. May be repeated."""
        handle, self._handle = self._handle, None
        if handle is not None:
            os.close(handle)


class VideoFiles:
    """Writes frame after frame; a new file every minute, and where size or depth change.

    Parameters
    ----------
    folder
        Where they go.
    open_file
        Opens one for writing.
    """

    def __init__(self, folder: Path, open_file: Callable[[Path], Output] = HashedFile) -> None:
        self._folder, self._open_file = folder, open_file
        self._count = 0
        self._file: _VideoFile | None = None
        self.finished: list[Finished] = []
        """Files that are complete, for the caller to take."""

    def write(self, frame: Frame) -> tuple[str, int, int]:
        """Append a frame; gives the file's name, the frame's place in it, and its presentation time, us.

        Raises
        ------
        OSError
            There is no room for it.
        """
        if self._file is not None and not self._file.takes(frame):
            self.close()
        if self._file is None:
            self._file = _VideoFile(self._folder, self._count, frame, self._open_file)
            self._count += 1
        return self._file.name, *self._file.write(frame)

    @property
    def written(self) -> Written | None:
        """How much of the file that is open there is; None where none is."""
        return None if self._file is None else self._file.written

    def close(self) -> None:
        """Write the end of the file that is open; raises OSError where there is no room for it."""
        file, self._file = self._file, None
        if file is not None:
            self.finished.append(file.finish())

    def abort(self) -> None:
        """Let go of the file that is open as it is."""
        file, self._file = self._file, None
        if file is not None:
            file.abort()


class _VideoFile:
    def __init__(self, folder: Path, number: int, first: Frame, open_file: Callable[[Path], Output]) -> None:
        size = first.size_px
        small = size[0] * size[1] <= SMALL_PX and first.pixel_format is PixelFormat.MONO8
        kind, codec, suffix, self._tick_us = (
            ("matroska", "ffv1", "mkv", 1000) if small else ("nut", "ffvhuff", "nut", 1)
        )
        self.name = f"{number:06d}.{suffix}"
        self._form, self._began_ns = (size, first.pixel_format), first.received_ns
        self._count, self._pts_us = 0, -1
        self._output = open_file(folder / self.name)
        options = {"level": "3", "slicecrc": "1", "g": "1"} if small else {}
        muxer = {"flush_packets": "1", **({"cluster_time_limit": "500"} if small else {})}
        self._container = av.open(self._output, "w", format=kind, options=muxer, buffer_size=BUFFER_BYTES)
        stream = self._container.add_stream(codec, rate=Fraction(25), options=options)
        self._stream: VideoStream = stream  # type: ignore[assignment]
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = PIXEL_FORMATS[first.pixel_format]
        self._time_base = Fraction(self._tick_us, 1_000_000)
        self._stream.time_base = self._stream.codec_context.time_base = self._time_base
        self._stream.codec_context.thread_count = 1

    def takes(self, frame: Frame) -> bool:
        """Whether a frame goes into this file."""
        return (frame.size_px, frame.pixel_format) == self._form and frame.received_ns - self._began_ns < FILE_NS

    def write(self, frame: Frame) -> tuple[int, int]:
        tick = max((frame.received_ns - self._began_ns) // 1000, self._pts_us + self._tick_us) // self._tick_us
        picture = av.VideoFrame.from_ndarray(frame.pixels, PIXEL_FORMATS[frame.pixel_format])
        picture.pts, picture.time_base = tick, self._time_base
        self._container.mux(self._stream.encode(picture))
        self._pts_us = tick * self._tick_us
        self._count += 1
        return self._count - 1, self._pts_us

    @property
    def written(self) -> Written:
        return Written(self.name, self._output.size_bytes, self._output.sha256)

    def finish(self) -> Finished:
        try:
            self._container.mux(self._stream.encode(None))
            self._container.close()
        finally:
            self._output.close()
        return Finished(self.name, self._output.size_bytes, self._output.sha256)

    def abort(self) -> None:
        with contextlib.suppress(
            OSError, av.FFmpegError
        ):  # it fails as the last write did; the container's memory is let go
            self._container.close()
        self._output.close()
