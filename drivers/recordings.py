"""What a recording is, whatever holds it; and recordings that are pictures in files of their own."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.decoding import decode_picture
from drivers.errors import DeviceNotFoundError, UnsupportedFormatError
from drivers.frame import PixelFormat
from drivers.grabber import FrameFormat

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence
    from pathlib import Path

    from drivers.frame import Pixels

__all__ = ["PICTURE_SUFFIXES", "Picture", "PictureRecording", "Recording", "fault_in", "pictures_in"]

PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm")


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One picture of a recording.

    Attributes
    ----------
    number
        Its place in the recording; a gap is a picture that the recording lost.
    time_ns
        When it is to be shown, from the first picture on.
    pixels
        Read-only; zeros where there is nothing that can be decoded.
    defect
        None, or in words what is wrong with it.
    """

    number: int
    time_ns: int
    pixels: Pixels
    defect: str | None = None


class Recording(ABC):
    """Pictures in their order, any number of times.

    Attributes
    ----------
    name
        What errors call it.
    format
        Of the first picture that can be read.
    frame_count
        How many pictures it says it has; from its duration where it only tells that; None where it tells nothing.
    period_ns
        Time from one picture to the next, on average.
    """

    name: str
    format: FrameFormat
    frame_count: int | None
    period_ns: int

    @property
    def duration_s(self) -> float | None:
        """Playing time, s."""
        return None if self.frame_count is None else self.frame_count * self.period_ns / 1e9

    @abstractmethod
    def pictures(self) -> Generator[Picture]:
        """Play from the beginning. Raises DeviceDisconnectedError where the recording breaks off."""


def fault_in(pixels: Pixels, format_: FrameFormat) -> str | None:
    """Name what shows that a decoded picture is not one of its recording: another size or depth, or nothing on it."""
    height, width = pixels.shape
    if (width, height) != (format_.width_px, format_.height_px):
        return f"is {width}x{height} px in a recording of {format_.width_px}x{format_.height_px} px"
    if depth(pixels) is not format_.pixel_format:
        return f"is {depth(pixels)} in a recording of {format_.pixel_format}"
    if pixels[0, 0] == pixels[height // 2, width // 2] and np.all(pixels == pixels[0, 0]):
        return f"flat picture: every pixel is {pixels[0, 0]}"
    return None


def depth(pixels: Pixels) -> PixelFormat:
    """Grey depth of an array."""
    return PixelFormat.MONO8 if pixels.dtype == np.uint8 else PixelFormat.MONO16


def blank(format_: FrameFormat) -> Pixels:
    """Zeros, to stand for a picture that cannot be decoded."""
    dtype = np.uint8 if format_.pixel_format is PixelFormat.MONO8 else np.uint16
    pixels = np.zeros((format_.height_px, format_.width_px), dtype)
    pixels.flags.writeable = False
    return pixels


def pictures_in(folder: Path) -> list[Path]:
    """Picture files of a folder in natural order (2 before 10). Hidden files and sub-folders are left out."""
    try:
        found = [p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES and not p.name.startswith(".")]
    except OSError as error:
        raise DeviceNotFoundError(
            str(folder), f"cannot be listed: {error.strerror}; check the path and its rights"
        ) from error
    return sorted(found, key=_natural)


def _natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    parts = re.split(r"(\d+)", path.name.lower())
    return [(int(p), "") if p.isdigit() else (-1, p) for p in parts], path.name


class PictureRecording(Recording):
    """Picture files played at an assumed rate. A file that cannot be decoded is a blank picture with a defect.

    Parameters
    ----------
    files
        In playing order.
    rate_hz
        Pictures a second.
    name
        What errors call it.

    Raises
    ------
    DeviceNotFoundError
        There is no file.
    UnsupportedFormatError
        None of the files can be decoded.
    """

    def __init__(self, files: Sequence[Path], *, rate_hz: float, name: str) -> None:
        self.name, self._files = name, tuple(files)
        self.frame_count = len(self._files)
        self.period_ns = round(1e9 / rate_hz)
        if not self._files:
            raise DeviceNotFoundError(
                name, f"holds no picture ({', '.join(s[1:] for s in PICTURE_SUFFIXES)}); give another path"
            )
        self.format = self._first_format(rate_hz)

    def _first_format(self, rate_hz: float) -> FrameFormat:
        faults: list[UnsupportedFormatError] = []
        for file in self._files:
            try:
                pixels, _ = _read(file)
            except UnsupportedFormatError as error:
                faults.append(error)
                continue
            height, width = pixels.shape
            return FrameFormat(width, height, depth(pixels), file.suffix[1:].lower(), rate_hz)
        if len(faults) == 1:
            raise UnsupportedFormatError(self.name, faults[0].message)
        raise UnsupportedFormatError(
            self.name, f"{faults[0]} (the first of {len(faults)} files, none of which can be read)"
        )

    def pictures(self) -> Generator[Picture]:
        """Decode one file after the other."""
        for number, file in enumerate(self._files):
            try:
                pixels, complaint = _read(file)
            except UnsupportedFormatError as error:
                pixels, complaint = blank(self.format), str(error)
            yield Picture(number, number * self.period_ns, pixels, complaint or fault_in(pixels, self.format))


def _read(file: Path) -> tuple[Pixels, str | None]:
    try:
        data = file.read_bytes()
    except OSError as error:
        raise UnsupportedFormatError(file.name, f"cannot be read: {error.strerror}; check its rights") from error
    return decode_picture(data, file.name)
