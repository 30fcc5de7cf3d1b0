"""What is shown of a frame: eight bits, and of interlaced video the one field that was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from drivers.frame import Frame

__all__ = ["ShownPictures"]


class ShownPictures:
    """Makes pictures to look at of one stream's frames."""

    def __init__(self) -> None:
        self._bits = 8

    def picture(self, frame: Frame, shown: str) -> NDArray[np.uint8]:
        """The whole frame, (height, width) uint8, or one field of it ("top", "bottom") with its lines filled up."""
        pixels = _whole(frame.pixels, shown, frame.field in ("top", "bottom"))
        if pixels.dtype != np.uint8:  # 9 to 16 bit keep their values: the brightest so far tells how many bits are used
            self._bits = max(self._bits, int(pixels.max(initial=0)).bit_length())
            pixels = pixels >> (self._bits - 8)
        return pixels.astype(np.uint8, copy=False)


def _whole(pixels: NDArray[Any], shown: str, alone: bool) -> NDArray[Any]:
    """Fill the lines of one field up to a whole picture; what is no field is returned as it is."""
    if shown not in ("top", "bottom"):
        return pixels
    parity = int(shown == "bottom")
    lines = pixels if alone else pixels[parity::2]
    whole = np.repeat(lines, 2, axis=0)
    whole[1 + parity : len(whole) - 1 + parity : 2] = cv2.addWeighted(lines[:-1], 0.5, lines[1:], 0.5, 0)
    return whole
