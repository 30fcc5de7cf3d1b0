"""One picture, owned by whoever holds it."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Pixels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Field", "Frame", "PixelFormat"]


class Field(enum.StrEnum):
    """Which lines of the interlaced scan a frame holds.

    `TOP` is the even rows (0, 2, ...) of the full frame, `BOTTOM` the odd ones. `UNKNOWN` is a full frame of which the
    source does not say whether its two fields were exposed together.
    """

    PROGRESSIVE = "progressive"
    INTERLACED_TOP_FIRST = "interlaced-top-first"
    INTERLACED_BOTTOM_FIRST = "interlaced-bottom-first"
    TOP = "top"
    BOTTOM = "bottom"
    UNKNOWN = "unknown"


class PixelFormat(enum.StrEnum):
    """Grey values as delivered. Colour sources deliver their luma."""

    MONO8 = "mono8"
    MONO16 = "mono16"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A grey picture with where and when it came from. Immutable: the pixels are read-only and nobody else's.

    Attributes
    ----------
    pixels
        ``(height, width)`` uint8 or uint16, C-contiguous, not writeable. A single field has its own lines only.
    sequence
        The device's frame number, growing by one a frame from `start` on: a gap means frames lost before they
        reached us. Fields of one frame share it. None where the device does not count.
    timestamp_ns
        When the exposure ended, on the monotonic clock of the machine; for a recording, its presentation time.
    received_ns
        When the driver had the whole frame, on the clock handed to the grabber.
    field
        Which lines it holds.
    pixel_format
        Grey depth.
    source
        The grabber's name.
    generation
        Grows by one each time the grabber is opened: sequence numbers compare within one generation only.
    defect
        None, or in words what is wrong with the picture (a device's error flag, a truncated buffer). A frame with a
        defect is delivered and counted as corrupt, never measured.
    """

    pixels: Pixels
    sequence: int | None
    timestamp_ns: int
    received_ns: int
    field: Field
    pixel_format: PixelFormat
    source: str
    generation: int
    defect: str | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of what `pixels` holds, px."""
        return self.pixels.shape[1], self.pixels.shape[0]
