"""Videos as recordings, through PyAV: by presentation time, in one thread, so that every run gives the same."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING

import av

from drivers.decoding import Complaints, luma
from drivers.errors import DeviceDisconnectedError, DevicePermissionError, UnsupportedFormatError
from drivers.grabber import FrameFormat
from drivers.recordings import Picture, Recording, blank, depth, fault_in

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator
    from pathlib import Path

    from av.container import InputContainer
    from av.video.stream import VideoStream

    from drivers.frame import Pixels

__all__ = ["VideoRecording"]

ASSUMED_RATE_HZ = Fraction(25)
PROBED_PACKETS = 500
STEADY_AFTER = 4  # equal steps that make a recording a steady one
SLACK = 1.5  # a step longer than this many periods is a gap
NUT_INDEX, NUT_TAIL = bytes.fromhex("4e58dd672f23e64e"), 12  # how the index begins; its length and checksum at its end


class VideoRecording(Recording):
    """A video file: whatever container and codec FFmpeg reads, the best video stream of it.

    A picture that its decoder patched, and those built on it up to the next key frame, have a defect. Where a packet
    yields no picture, a blank one with a defect stands for it. A steady recording that skips a beat has lost pictures:
    their numbers are left out. What a codec has no check for stays unseen: FFV1 with checksums finds every changed
    byte, H.264, MPEG-4 and MJPEG nearly every burst, raw video and ffvhuff none.

    Raises
    ------
    DevicePermissionError
        This user may not read it.
    UnsupportedFormatError
        No picture of it can be decoded; the message says why.
    """

    def __init__(self, path: Path, *, name: str) -> None:
        self.name, self._path = name, path
        with self._open() as container:
            stream = _video_stream(container, name)
            rate = stream.average_rate or stream.guessed_rate or ASSUMED_RATE_HZ
            self.period_ns = round(1e9 / rate)
            self.declared_packets = stream.frames or None
            self.declared_end_s = _declared_end_s(container, stream)
            self.inter_coded = not stream.codec_context.codec.intra_only
            estimate = None if self.declared_end_s is None else round(self.declared_end_s * rate)
            self.frame_count = self.declared_packets or estimate
            pixels = self._first_pixels(container, stream)
            height, width = pixels.shape
            self.format = FrameFormat(width, height, depth(pixels), stream.codec_context.name, float(rate))

    def _open(self) -> InputContainer:
        with Complaints() as complaints:
            try:
                return av.open(f"file:{self._path}", metadata_errors="replace")  # a colon in its name is no protocol
            except PermissionError as error:
                raise DevicePermissionError(self.name, "may not be read by this user; check its rights") from error
            except av.FFmpegError as error:
                why = "is no video that can be read; check that it is the right file"
                if any("moov atom" in text for text in complaints.texts) and self._bytes(4, 4) == b"ftyp":
                    why = "is cut short: its index, written last, is missing; copy it again, or record to MKV"
                raise UnsupportedFormatError(self.name, why) from error

    def _bytes(self, at: int, count: int) -> bytes:
        """Some bytes of the file; a negative place counts from its end."""
        with self._path.open("rb") as file:
            file.seek(at, os.SEEK_SET if at >= 0 else os.SEEK_END)
            return file.read(count)

    def is_finished(self, container: InputContainer) -> bool:
        """Whether the file has the end that its container writes last; true where the container has none."""
        if container.format.name != "nut" or self._path.stat().st_size < NUT_TAIL:
            return True
        length = int.from_bytes(self._bytes(-NUT_TAIL, 8), "big")
        return 8 <= length <= self._path.stat().st_size and self._bytes(-length, 8) == NUT_INDEX

    def _first_pixels(self, container: InputContainer, stream: VideoStream) -> Pixels:
        for tried, (_, frames) in enumerate(_decode(container, stream)):
            if frames:
                return luma(frames[0], self.name)
            if tried == PROBED_PACKETS:
                break
        codec = stream.codec_context.name
        raise UnsupportedFormatError(
            self.name, f"holds no {codec} picture that can be decoded: damaged or cut short; copy it again"
        )

    def pictures(self) -> Generator[Picture]:
        """Decode from the beginning. Raises DeviceDisconnectedError where the video breaks off."""
        with self._open() as container:
            yield from _Playback(self, container).run()


def _video_stream(container: InputContainer, name: str) -> VideoStream:
    stream = container.streams.best("video")
    if stream is None or container.format.name == "tty":  # FFmpeg draws a .txt file as video
        raise UnsupportedFormatError(name, "holds no video; check that it is the right file")
    if stream.codec_context is None:
        raise UnsupportedFormatError(name, "is coded in a way that cannot be decoded here; convert it to H.264 or FFV1")
    return stream  # type: ignore[return-value]


def _declared_end_s(container: InputContainer, stream: VideoStream) -> float | None:
    """When the video ends by its own account: the stream's tag, or the file's duration where it has but one stream."""
    tag = re.fullmatch(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stream.metadata.get("DURATION", ""))  # Matroska's
    if tag is not None:
        return 3600 * int(tag[1]) + 60 * int(tag[2]) + float(tag[3])
    if container.duration is None or len(container.streams) != 1:
        return None
    return container.duration / 1e6


@dataclass(slots=True, eq=False)
class _Packet:
    """What is known of one packet. It goes through the decoder and comes out with the picture made of it.

    It must not hold that picture: the two would keep each other alive.
    """

    pts: int | None = None
    complaints: list[str] = field(default_factory=list)
    """What the decoder said of it."""
    jumped: list[str] = field(default_factory=list)
    """What the container's reader said on the way to it."""
    failed: bool = False
    """Nothing could be made of it."""
    at_end: bool = False
    """It is none: the decoder gives its last pictures."""


def _decode(container: InputContainer, stream: VideoStream) -> Iterator[tuple[_Packet, list[av.VideoFrame]]]:
    """Demux and decode to the end, or to where the container cannot be read on."""
    stream.codec_context.thread_count = 1
    stream.codec_context.copy_opaque = True
    packets = container.demux(stream)
    while True:
        with Complaints() as complaints:
            try:
                packet = next(packets, None)
            except av.FFmpegError as error:
                yield _Packet(at_end=True, jumped=[*complaints.texts, str(error.strerror)]), []
                return
        if packet is None:
            return
        known = _Packet(packet.pts, jumped=complaints.texts, at_end=packet.size == 0)
        packet.opaque = known
        yield known, _decode_packet(packet, known)


def _decode_packet(packet: av.Packet[VideoStream], known: _Packet) -> list[av.VideoFrame]:
    frames: list[av.VideoFrame] = []
    if packet.is_corrupt:
        known.complaints.append("the packet is cut short")
    with Complaints() as complaints:
        try:
            frames = packet.decode()
        except av.FFmpegError as error:
            known.failed = not known.at_end
            known.complaints.extend([*complaints.texts, str(error.strerror)])
            return frames
    known.complaints.extend(complaints.texts)
    return frames


class _Playback:
    """One pass through a video."""

    def __init__(self, video: VideoRecording, container: InputContainer) -> None:
        self._video, self._container = video, container
        self._stream = _video_stream(container, video.name)
        self._beat = _Beat(video.period_ns)
        self._number = -1
        self._tainted = False
        self._failed: list[_Packet] = []
        self._packets = 0
        self._last_damaged = False

    def run(self) -> Iterator[Picture]:
        end: list[str] = []
        for packet, frames in _decode(self._container, self._stream):
            if packet.at_end:
                end = packet.jumped
            else:
                self._packets += 1
                self._last_damaged = bool(packet.complaints)
                self._tainted |= self._video.inter_coded and bool(packet.jumped or packet.complaints)
            for frame in frames:
                yield from self._blanks_before(frame.pts)
                yield self._picture(frame, frame.opaque if isinstance(frame.opaque, _Packet) else packet)
            if packet.failed:
                self._failed.append(packet)
        if why := self._broken(end):
            total = "" if self._video.frame_count is None else f" of about {self._video.frame_count}"
            raise DeviceDisconnectedError(
                self._video.name,
                f"breaks off after picture {self._number + 1}{total} ({why}); copy it again, or use what there is",
            )
        yield from self._blanks_before(None)

    def _picture(self, frame: av.VideoFrame, packet: _Packet) -> Picture:
        number, time_ns = self._place(frame.pts, jumped=bool(packet.jumped))
        complaint = next(iter(packet.complaints), "decoder: patched a damaged picture" if frame.is_corrupt else None)
        if complaint is not None:
            self._tainted = self._video.inter_coded
        elif self._tainted:
            self._tainted = not frame.key_frame
            complaint = "built on a damaged picture" if self._tainted else None
        pixels = luma(frame, self._video.name)
        return Picture(number, time_ns, pixels, complaint or fault_in(pixels, self._video.format))

    def _blanks_before(self, pts: int | None) -> Iterator[Picture]:
        """Blank pictures for packets that failed and would have been shown before `pts`; None: for all."""
        due = [p for p in self._failed if pts is None or p.pts is None or p.pts < pts]
        self._failed = [p for p in self._failed if p not in due]
        for packet in sorted(due, key=lambda p: p.pts or 0):
            number, time_ns = self._place(packet.pts, jumped=bool(packet.jumped))
            yield Picture(number, time_ns, blank(self._video.format), packet.complaints[0])

    def _place(self, pts: int | None, *, jumped: bool) -> tuple[int, int]:
        time_base = self._stream.time_base or Fraction(1)
        time_ns, missing = self._beat.next(None if pts is None else round(pts * time_base * 10**9), jumped=jumped)
        self._number += 1 + missing
        return self._number, time_ns

    def _broken(self, end: list[str]) -> str | None:
        """Say why this is not the recording's end, where it is not."""
        video = self._video
        if video.declared_packets is not None:
            missing = video.declared_packets - self._packets
            return f"{missing} packets are missing" if missing > 0 else None
        if end:
            return end[0]
        if not video.is_finished(self._container):
            return "its index, written last, is missing"
        if video.declared_end_s is not None and self._beat.end_s(SLACK) < video.declared_end_s:
            return f"{video.declared_end_s - self._beat.end_s(1):.2f} s are missing"
        return "its last packet is damaged" if self._last_damaged else None


class _Beat:
    """Presentation times, ns, from the first picture on, and how many pictures a jump in a steady beat left out."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._first_ns: int | None = None
        self._last_ns = 0
        self._shortest_ns, self._longest_ns, self._steps = 0, 0, 0
        self._trusted = True

    def next(self, pts_ns: int | None, *, jumped: bool) -> tuple[int, int]:
        """Time of the next picture and the number of pictures missing before it.

        `jumped` says that the file's reader had to skip something here: then the average rate serves as the beat.
        Times that are absent or go back (an AVI with B-frames) are not believed: the average rate counts on.
        """
        if self._first_ns is None:
            self._first_ns = pts_ns or 0
            return 0, 0
        time_ns = (pts_ns or 0) - self._first_ns
        self._trusted &= pts_ns is not None and time_ns > self._last_ns
        if not self._trusted:
            time_ns = self._last_ns + self._period_ns
        step_ns, self._last_ns = time_ns - self._last_ns, time_ns
        return time_ns, self._missing(step_ns, jumped=jumped)

    def _missing(self, step_ns: int, *, jumped: bool) -> int:
        steady = self._steps >= STEADY_AFTER and self._longest_ns < SLACK * self._shortest_ns
        beat_ns = (self._shortest_ns + self._longest_ns) / 2 if steady else self._period_ns
        if (steady or jumped) and step_ns > SLACK * beat_ns:
            return round(step_ns / beat_ns) - 1
        self._shortest_ns = min(step_ns, self._shortest_ns or step_ns)
        self._longest_ns = max(step_ns, self._longest_ns)
        self._steps += 1
        return 0

    def end_s(self, periods: float) -> float:
        """When the last picture has been shown for so many periods, on the recording's own clock, s."""
        return ((self._first_ns or 0) + self._last_ns + periods * self._period_ns) / 1e9
