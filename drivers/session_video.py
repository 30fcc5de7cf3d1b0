"""The video files of a recorded session, read forward, each picture found by its presentation time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import av

from drivers.decoding import Complaints, luma
from drivers.errors import UnsupportedFormatError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType

    from av.container import InputContainer
    from av.video.stream import VideoStream

    from drivers.frame import Pixels

__all__ = ["PictureLostError", "SessionVideo"]


class PictureLostError(Exception):
    """A picture is not in the video, or cannot be decoded; in words."""


class SessionVideo:
    """One video file, whole or cut short; every picture in it stands for itself.

    Raises
    ------
    PictureLostError
        There is no such file, or nothing in it can be read.
    """

    def __init__(self, path: Path) -> None:
        self._name = path.name
        with Complaints():
            try:
                self._container: InputContainer = av.open(f"file:{path}")
            except (av.FFmpegError, OSError) as error:
                raise PictureLostError(f"video {path.name} cannot be opened: {error.strerror}") from error
        self._packets = self._demux()
        self._next = next(self._packets, None)

    def _demux(self) -> Iterator[tuple[int, av.Packet[VideoStream]]]:
        """Packets with their times, us, up to where the file ends or cannot be read on."""
        if not self._container.streams.video:
            return
        stream = self._container.streams.video[0]
        stream.codec_context.thread_count = 1
        packets = self._container.demux(stream)
        while True:
            with Complaints():
                try:
                    packet = next(packets, None)
                except av.FFmpegError:
                    return
            if packet is None:
                return
            if packet.pts is not None and packet.time_base is not None:
                yield round(packet.pts * packet.time_base * 1_000_000), packet

    def read(self, pts_us: int) -> Pixels:
        """Decode the picture of that time; those before it are passed over, and gone.

        Raises
        ------
        PictureLostError
            It is not there, or cannot be decoded.
        """
        while self._next is not None and self._next[0] < pts_us:
            self._next = next(self._packets, None)
        if self._next is None or self._next[0] > pts_us:
            raise PictureLostError(f"video {self._name} has no picture at {pts_us / 1e6:.3f} s")
        packet = self._next[1]
        self._next = next(self._packets, None)
        return self._decode(packet)

    def _decode(self, packet: av.Packet[VideoStream]) -> Pixels:
        frames: list[av.VideoFrame] = []
        with Complaints() as complaints:
            try:
                frames = packet.decode()
                if frames:
                    return luma(frames[0], self._name)
            except (av.FFmpegError, UnsupportedFormatError):
                pass
        why = next(iter(complaints.texts), "the decoder gave no picture")
        raise PictureLostError(f"video {self._name} cannot be decoded here: {why}")

    @property
    def at_end(self) -> bool:
        """Whether there is no further picture."""
        return self._next is None

    def close(self) -> None:
        """Let the file go."""
        self._packets = iter(())
        self._next = None
        self._container.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
