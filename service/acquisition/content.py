"""Whether pictures are those of a camera: frozen and flat ones come from a grabber that has nothing to show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from drivers.grabber import SignalStatus

if TYPE_CHECKING:
    from drivers.frame import Field, Frame, Pixels

__all__ = ["Content", "PictureWatch", "frozen", "is_flat", "is_same", "no_picture"]

STEP: Final = 8
"""Every so manieth row and column is looked at first: of a camera's pictures, noise and light tell at once."""
NO_SIGNAL_WORDS: Final = {
    SignalStatus.NO_SIGNAL: "the input has no signal",
    SignalStatus.NO_LOCK: "the input's signal cannot be locked to",
}


def is_flat(pixels: Pixels, levels: int) -> bool:
    """Whether all grey values lie within so many levels."""
    return int(np.ptp(pixels[::STEP, ::STEP])) <= levels and int(np.ptp(pixels)) <= levels


def is_same(pixels: Pixels, before: Pixels) -> bool:
    """Whether two pictures are the same byte for byte."""
    if pixels is before:
        return True
    if pixels.shape != before.shape or pixels.dtype != before.dtype:
        return False
    return np.array_equal(pixels[::STEP, ::STEP], before[::STEP, ::STEP]) and np.array_equal(pixels, before)


@dataclass(frozen=True, slots=True)
class Content:
    """What the last frames of a stream showed.

    Attributes
    ----------
    same, flat
        How many in a row, up to the last one, are the same as it, or flat.
    same_since_ns
        When the first of those that are the same was received.
    signal
        What the device says of its signal.
    """

    same: int = 0
    flat: int = 0
    same_since_ns: int = 0
    signal: SignalStatus = SignalStatus.UNKNOWN


class PictureWatch:
    """Looks at every frame of a live source, and marks those that are no camera's pictures as bad.

    Marked so, they are shown and recorded, never measured: nothing can take what was measured on them for live.

    Parameters
    ----------
    frozen_frames
        So many in a row that are the same, or flat, are frozen, or flat.
    flat_levels
        See `is_flat`; of 16-bit pictures as well.
    """

    def __init__(self, frozen_frames: int, flat_levels: int) -> None:
        self._frozen_frames, self._flat_levels = frozen_frames, flat_levels
        self.restart()

    def restart(self) -> None:
        """Forget the frames so far: a stream begins."""
        self._before: dict[Field, tuple[Pixels, int]] = {}  # of interlaced video, each field has its own past
        self.content = Content()

    def signalled(self, signal: SignalStatus) -> None:
        """Take note of what the device says of its signal."""
        self.content = replace(self.content, signal=signal)

    def look(self, frame: Frame) -> Frame:
        """Give the frame, marked as bad where it is frozen or flat, or the device says that there is no signal."""
        before, c = self._before.get(frame.field), self.content
        same = before is not None and is_same(frame.pixels, before[0])
        count = before[1] + 1 if before is not None and same else 1
        self._before[frame.field] = frame.pixels, count
        flat = is_flat(frame.pixels, self._flat_levels)
        self.content = Content(
            same=count,
            flat=c.flat + 1 if flat else 0,
            same_since_ns=c.same_since_ns if same else frame.received_ns,
            signal=c.signal,
        )
        reason = self.reason()
        return frame if reason is None or frame.defect is not None else replace(frame, defect=reason)

    def reason(self) -> str | None:
        """In words, why the last frame is no camera's picture; None where it may be one."""
        return no_picture(self.content, self._frozen_frames) or frozen(self.content, self._frozen_frames)


def no_picture(content: Content, frames: int) -> str | None:
    """In words, why there is nothing to be seen; None where there is something."""
    if content.signal in NO_SIGNAL_WORDS:
        return NO_SIGNAL_WORDS[content.signal]
    return "the picture is one even grey: no signal, or no light" if content.flat >= frames else None


def frozen(content: Content, frames: int) -> str | None:
    """In words, that the picture stands still as no camera's does; None where it does not."""
    return "the picture is frozen: the same byte for byte" if content.same >= frames else None
