"""Device buffers as grey pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from drivers.decoding import decode_picture
from drivers.errors import UnsupportedFormatError
from drivers.frame import PixelFormat
from drivers.pool import read_only

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from drivers.frame import Pixels
    from drivers.pool import FramePool

__all__ = ["ENCODINGS", "Encoding", "Layout", "picture"]


@dataclass(frozen=True, slots=True)
class Encoding:
    """How a pixel format keeps its luma.

    Attributes
    ----------
    name
        Its four-character code.
    bytes_per_px
        From one luma value to the next; 0 for JPEG.
    offset
        Of the first luma value in a line.
    dtype
        Of a luma value in the buffer.
    total
        Bytes of all planes over those of the luma's.
    """

    name: str
    bytes_per_px: int
    offset: int = 0
    dtype: str = "u1"
    total: float = 1.0

    @property
    def pixel_format(self) -> PixelFormat:
        """Depth of the pictures. Ten bits stay ten bits."""
        return PixelFormat.MONO8 if self.dtype == "u1" else PixelFormat.MONO16


ENCODINGS: Final = {
    e.name: e
    for e in (
        Encoding("GREY", 1),
        Encoding("NV12", 1, total=1.5),
        Encoding("YUYV", 2),
        Encoding("UYVY", 2, offset=1),
        Encoding("Y16", 2, dtype="<u2"),
        Encoding("Y16-BE", 2, dtype=">u2"),
        Encoding("Y12", 2, dtype="<u2"),
        Encoding("Y10", 2, dtype="<u2"),
        Encoding("MJPG", 0),
        Encoding("JPEG", 0),
    )
}
"""By name, the preferred first: exact before compressed, and of the exact those of 8 bit first."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A device's buffer."""

    width_px: int
    height_px: int
    stride_bytes: int
    encoding: Encoding

    @property
    def size_bytes(self) -> int:
        """Of a whole buffer; 0 where that varies."""
        return round(self.stride_bytes * self.height_px * self.encoding.total) if self.encoding.bytes_per_px else 0


def picture(data: NDArray[np.uint8], layout: Layout, pool: FramePool, device: str) -> tuple[Pixels, str | None]:
    """Copy a buffer's luma out of device memory, once.

    Parameters
    ----------
    data
        (n,) bytes that the device filled.
    pool
        Where pictures of the layout's size get their memory.

    Returns
    -------
    tuple
        (height, width) read-only pixels, and None or what is wrong with them. What the device left out is black.
    """
    if layout.encoding.bytes_per_px:
        return _plain(data, layout, pool)
    try:
        pixels, complaint = decode_picture(data.tobytes(), device)
    except UnsupportedFormatError as error:
        return _black(pool), f"its JPEG {error.message.partition(';')[0]}"
    if pixels.shape != (layout.height_px, layout.width_px):
        height, width = pixels.shape
        return _black(pool), f"its JPEG is {width}x{height} px instead of {layout.width_px}x{layout.height_px}"
    return pixels, complaint and f"its JPEG is damaged ({complaint})"


def _black(pool: FramePool) -> Pixels:
    memory = pool.take()
    memory.fill(0)
    return read_only(memory)


def _plain(data: NDArray[np.uint8], layout: Layout, pool: FramePool) -> tuple[Pixels, str | None]:
    memory, missing = pool.take(), layout.size_bytes - data.size
    rows = min(data.size // layout.stride_bytes, layout.height_px)
    _copy_luma(data, layout, memory[:rows])
    memory[rows:].fill(0)
    return read_only(memory), f"holds {data.size} of {layout.size_bytes} bytes" if missing > 0 else None


def _copy_luma(data: NDArray[np.uint8], layout: Layout, rows: Pixels) -> None:
    encoding, (height, width) = layout.encoding, rows.shape
    if not height:
        return
    source: NDArray[Any]
    if encoding.dtype == "u1" and encoding.bytes_per_px == 2:
        source = np.ndarray((height, width, 2), np.uint8, data, 0, (layout.stride_bytes, 2, 1))
        cv2.extractChannel(source, encoding.offset, rows)  # ten times as fast as a strided copy
    else:
        strides = (layout.stride_bytes, encoding.bytes_per_px)
        source = np.ndarray((height, width), encoding.dtype, data, encoding.offset, strides)
        np.copyto(rows, source)
