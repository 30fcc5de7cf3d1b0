"""Recordings made for tests: small videos and folders whose pictures tell their number."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

SIZE = (64, 48)


def picture(number: int, size: tuple[int, int] = SIZE, dtype=np.uint8) -> np.ndarray:
    """A noisy picture whose mean grows with its number: a flat codec cannot hide a mistake in it."""
    width, height = size
    grey = np.random.default_rng(number).integers(40, 200, (height, width))
    grey[: height // 4] = 10 + 3 * number
    return (grey * (257 if dtype == np.uint16 else 1)).astype(dtype)


def number_of(pixels: np.ndarray) -> int:
    """Which picture it is."""
    top = pixels[: max(1, len(pixels) // 4 - 2), 4:-4].astype(float)
    return round((top.mean() / (257 if pixels.dtype == np.uint16 else 1) - 10) / 3)


def write_video(
    path: Path, pictures, codec="ffv1", pix_fmt="gray", *, rate=25, pts=None, options=None, mux_options=None
) -> Path:
    """Encode pictures (grey, or RGB as (h, w, 3)) with one thread; `pts` in frame periods."""
    pictures = list(pictures)
    height, width = pictures[0].shape[:2]
    with av.open(str(path), "w", options=mux_options or {}) as container:
        stream = container.add_stream(codec, rate=rate, options=options or {})
        stream.width, stream.height, stream.pix_fmt = width, height, pix_fmt
        stream.codec_context.thread_count = 1
        for i, grey in enumerate(pictures):
            frame = _frame(grey, pix_fmt)
            frame.pts, frame.time_base = (i if pts is None else pts[i]), Fraction(1, rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def _frame(pixels: np.ndarray, pix_fmt: str) -> av.VideoFrame:
    """Colour is converted; grey goes into the format's luma as it is, a conversion would squeeze its range."""
    if pixels.ndim == 3:
        return av.VideoFrame.from_ndarray(pixels, "rgb24").reformat(format=pix_fmt)
    height, width = pixels.shape
    frame = av.VideoFrame(width, height, pix_fmt)
    for plane in frame.planes[1:]:
        np.frombuffer(plane, np.uint8)[:] = 128
    rows = np.frombuffer(frame.planes[0], np.uint8).reshape(height, frame.planes[0].line_size)
    if pix_fmt in ("yuyv422", "uyvy422"):
        rows[:] = 128
        rows[:, pix_fmt.index("y") : 2 * width : 2] = pixels
    elif frame.format.components[0].bits > 8:
        rows.view(">u2" if frame.format.is_big_endian else "<u2")[:, :width] = pixels
    else:
        rows[:, :width] = pixels
    return frame


def write_folder(folder: Path, pictures, suffix=".png") -> Path:
    """Write pictures as 0.png, 1.png, ... so that only natural order is right."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, grey in enumerate(pictures):
        assert cv2.imwrite(str(folder / f"{i}{suffix}"), grey)
    return folder


def cut(path: Path, share: float) -> Path:
    """Leave only the first part of a file."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def overwrite(path: Path, at_share: float, count: int) -> Path:
    """Garble some bytes of a file."""
    data = bytearray(path.read_bytes())
    start = int(len(data) * at_share)
    for i in range(start, start + count):
        data[i] ^= 0x5A
    path.write_bytes(data)
    return path
