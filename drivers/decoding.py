"""FFmpeg's pictures as grey arrays, and what its decoders complain of while they make them.

A damaged stream seldom fails: FFmpeg patches the hole from the picture before and says so only in its log. So every
call is made under `Complaints`, and a picture that caused one is not sound.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Self

import av
import av.logging
import cv2
import numpy as np

from drivers.errors import UnsupportedFormatError

if TYPE_CHECKING:
    from types import TracebackType

    from numpy.typing import NDArray

    from drivers.frame import Pixels

__all__ = ["Complaints", "decode_picture", "luma"]

logging.getLogger("libav").addHandler(logging.NullHandler())

# Where the luma stands in formats that pack it between other values: first element, step.
_PACKED = {"yuyv422": (0, 2), "yvyu422": (0, 2), "uyvy422": (1, 2), "ya8": (0, 2), "ya16le": (0, 2), "ya16be": (0, 2)}
_HARMLESS = ("APP fields",)  # a webcam's private JPEG header
_CODEC_OF_MAGIC = {
    b"\x89PNG": "png",
    b"II*\0": "tiff",
    b"MM\0*": "tiff",
    b"BM": "bmp",
    b"\xff\xd8\xff": "mjpeg",
    b"P2": "pgm",
    b"P5": "pgm",
    b"P3": "ppm",
    b"P6": "ppm",
}


class Complaints:
    """The errors that FFmpeg logs within a `with` block, for decoders that run in the caller's thread only."""

    def __init__(self) -> None:
        av.logging.set_level(av.logging.ERROR)
        av.logging.set_skip_repeated(False)
        self._capture = av.logging.Capture()
        self._records: list[tuple[int, str, str]] = []

    def __enter__(self) -> Self:
        self._records = self._capture.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._capture.__exit__(None, None, None)

    @property
    def texts(self) -> list[str]:
        """One line each, oldest first."""
        lines = [f"{name}: {' '.join(text.split())}" for _, name, text in self._records]
        return [line for line in lines if not any(words in line for words in _HARMLESS)]


def luma(frame: av.VideoFrame, device: str) -> Pixels:
    """Grey values of a decoded picture, (height, width) uint8 or uint16, of its own memory and read-only.

    The luma plane as it stands, without range conversion; RGB by BT.601. Depths of 9 to 16 bit keep their values.
    """
    first, *others = frame.format.components
    if first.bits > 16:
        raise UnsupportedFormatError(
            device, f"has pictures of {first.bits} bit ({frame.format.name}); 8 to 16 can be read"
        )
    plain = first.is_luma and first.bits >= 8 and not frame.format.has_palette
    if not plain or frame.planes[0].line_size < 0:  # PyAV cannot look at bottom-up planes
        pixels = _gray_of_rgb(frame, first.bits)
    elif all(c.plane != first.plane for c in others):
        pixels = _plane(frame, 0, 1)
    elif frame.format.name in _PACKED:
        pixels = _plane(frame, *_PACKED[frame.format.name])
    else:
        pixels = _plane(frame.reformat(format="yuv444p" if first.bits == 8 else "yuv444p16le"), 0, 1)
    pixels.flags.writeable = False
    return pixels


def _plane(frame: av.VideoFrame, start: int, step: int) -> Pixels:
    rows = np.frombuffer(memoryview(frame.planes[0]), np.uint8).reshape(frame.height, -1)
    cut = slice(start, start + step * frame.width, step)
    if frame.format.components[0].bits == 8:
        return np.array(rows[:, cut], order="C")
    deep = rows.view(">u2" if frame.format.is_big_endian else "<u2")
    return np.array(deep[:, cut], dtype=np.uint16, order="C")


def _gray_of_rgb(frame: av.VideoFrame, bits: int) -> Pixels:
    # by way of a planar format: to the same format nothing is converted, and a bottom-up picture stays one
    planar = frame.reformat(format="gbrp16le" if bits > 8 else "gbrp")
    rgb: NDArray[np.uint8] | NDArray[np.uint16] = planar.reformat(
        format="rgb48le" if bits > 8 else "rgb24"
    ).to_ndarray()  # type: ignore[assignment]
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)  # type: ignore[return-value]


def decode_picture(data: bytes, device: str) -> tuple[Pixels, str | None]:
    """Pixels of a PNG, TIFF, BMP, JPEG, PGM or PPM file's bytes, and what its decoder complained of.

    Raises
    ------
    UnsupportedFormatError
        It holds no picture that can be decoded.
    """
    codec = next((name for magic, name in _CODEC_OF_MAGIC.items() if data.startswith(magic)), None)
    if codec is None:
        raise UnsupportedFormatError(
            device, "is empty" if not data else "is no PNG, TIFF, BMP, JPEG, PGM or PPM picture"
        )
    with Complaints() as complaints:
        try:
            frame = _decode_one(codec, data)
        except av.FFmpegError as error:
            words = [*complaints.texts, error.strerror]
            raise UnsupportedFormatError(device, f"is damaged or cut short ({words[0]}); copy it again") from error
    if frame is None:
        raise UnsupportedFormatError(device, "is cut short; copy it again")
    return luma(frame, device), next(iter(complaints.texts), None)


def _decode_one(codec: str, data: bytes) -> av.VideoFrame | None:
    context: av.VideoCodecContext = av.CodecContext.create(codec, "r")  # type: ignore[assignment]
    context.thread_count = 1
    frames = [*context.decode(av.Packet(data)), *context.decode(None)]
    return frames[0] if frames else None
