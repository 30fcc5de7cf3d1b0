"""From assembled frames to pictures: decoded, numbered, timed, and marked where something is wrong with them."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from drivers.encodings import picture
from drivers.fields import field_frames
from drivers.frame import Frame, PixelFormat
from drivers.pool import FramePool
from drivers.sequence import SEQUENCE_NUMBERS, SequenceExtender
from drivers.stamps import StampCheck, TimeGaps

if TYPE_CHECKING:
    from drivers.grabber import FieldMode, FrameFormat
    from drivers.uvc.negotiation import Choice
    from drivers.uvc.payload import AssembledFrame

__all__ = ["CaptureTimes", "UvcFrameMaker"]

POOL_FRAMES: Final = 16
OLDEST_NS: Final = 1_000_000_000
"""A frame that says that it is older when it arrives has no times to rely on."""
OFFSETS: Final = 32


class CaptureTimes:
    """Puts times of a device's clock on this machine's.

    A payload is never here before it was sent: the least that its arrival was ever behind, of late, is what lies
    between the two clocks; the rest is waiting.

    Parameters
    ----------
    clock_hz
        Of the device's clock; 0 where there is none.
    """

    def __init__(self, clock_hz: int) -> None:
        self._clock_hz = clock_hz
        self._clock = SequenceExtender()
        self._offsets_ns: deque[int] = deque(maxlen=OFFSETS)

    def captured_ns(self, frame: AssembledFrame) -> int:
        """When a frame was captured; when it arrived, where the device does not tell or cannot be right."""
        if not self._clock_hz or frame.captured is None or frame.sent is None:
            return frame.arrived_ns
        age_ns = (frame.sent - frame.captured) % SEQUENCE_NUMBERS * 1_000_000_000 // self._clock_hz
        if age_ns > OLDEST_NS:
            return frame.arrived_ns
        sent_ns = self._clock.extend(frame.sent) * 1_000_000_000 // self._clock_hz
        self._offsets_ns.append(frame.arrived_ns - sent_ns)
        stamp_ns = sent_ns + min(self._offsets_ns) - age_ns
        return stamp_ns if frame.arrived_ns - stamp_ns <= OLDEST_NS else frame.arrived_ns - age_ns


class UvcFrameMaker:
    """Makes the frames from `start` to `stop`.

    Parameters
    ----------
    source, generation
        As frames carry them.
    choice, granted
        What the device sends, and what is to be handed over.
    clock_hz
        Of the device's clock.
    own_numbers
        Number the frames handed over, instead of those that the device began.
    """

    def __init__(
        self, source: str, generation: int, choice: Choice, granted: FrameFormat, clock_hz: int, *, own_numbers: bool
    ) -> None:
        self._source, self._generation, self._own_numbers = source, generation, own_numbers
        self._granted, self._top_first, self._layout = granted, choice.format.top_first, choice.layout
        self._field_ns = round(0.5e9 / choice.rate_hz)
        dtype = np.uint8 if granted.pixel_format is PixelFormat.MONO8 else np.uint16
        self._pool = FramePool((self._layout.height_px, self._layout.width_px), dtype, POOL_FRAMES)
        self._times, self._stamps, self._gaps = CaptureTimes(clock_hz), StampCheck(), TimeGaps()
        self._made = 0
        self.missed_by_time = 0
        """How many frames before the last one are missing by the times alone."""

    def frames(self, assembled: AssembledFrame, received_ns: int, mode: FieldMode) -> tuple[Frame, ...]:
        """Make the frame, or its fields."""
        pixels, flaw = picture(np.frombuffer(assembled.data, np.uint8), self._layout, self._pool, self._source)
        stamp_ns = self._stamps.check(self._times.captured_ns(assembled), received_ns)
        self.missed_by_time = self._gaps.missing(assembled.number, stamp_ns)
        frame = Frame(
            pixels=pixels,
            sequence=self._made if self._own_numbers else assembled.number,
            timestamp_ns=stamp_ns,
            received_ns=received_ns,
            field=self._granted.field,
            pixel_format=self._granted.pixel_format,
            source=self._source,
            generation=self._generation,
            defect=assembled.flaw or flaw,
        )
        self._made += 1
        return field_frames(frame, mode, top_first=self._top_first, field_ns=self._field_ns)
