"""From the device's buffers to frames: copied, numbered, timed, and marked where something is wrong with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from drivers.encodings import picture
from drivers.fields import field_frames
from drivers.frame import Field, Frame, PixelFormat
from drivers.grabber import FieldMode
from drivers.pool import FramePool
from drivers.sequence import SequenceExtender
from drivers.stamps import StampCheck, TimeGaps
from drivers.v4l2.constants import FieldOrder

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from drivers.frame import Pixels
    from drivers.v4l2.formats import Grant
    from drivers.v4l2.ring import Lent

    Copied: TypeAlias = tuple[Pixels, str | None]

__all__ = ["FrameMaker"]

POOL_FRAMES: Final = 16
"""Pictures kept ready: as many as the service has in hand at once, and a few."""
SINGLE_FIELDS: Final = {FieldOrder.TOP: Field.TOP, FieldOrder.BOTTOM: Field.BOTTOM}


class FrameMaker:
    """Makes the frames from `start` to `stop`.

    Parameters
    ----------
    source, generation
        As frames carry them.
    own_numbers
        Number the frames handed over, instead of as the device does.
    """

    def __init__(self, source: str, generation: int, *, own_numbers: bool) -> None:
        self._source, self._generation, self._own_numbers = source, generation, own_numbers
        self._numbers, self._stamps, self._gaps = SequenceExtender(), StampCheck(), TimeGaps()
        self._made = 0
        self._shape: tuple[object, ...] = ()
        self.unsettled_until_ns = 0
        """What is stamped before this was being taken while the input was switched."""
        self.missed_by_time = 0
        """How many frames before the last one are missing by the times alone."""

    def begin(self, grant: Grant, field_mode: FieldMode) -> None:
        """Take note that the device begins to stream; numbers go on from those before."""
        self._grant, self._field_mode = grant, field_mode
        self._numbers.resume()
        self._stamps.restart()
        self._gaps.restart()
        self.unsettled_until_ns = 0
        layout = grant.layout
        dtype = np.uint8 if layout.encoding.pixel_format is PixelFormat.MONO8 else np.uint16
        self._pool = FramePool((layout.height_px, layout.width_px), dtype, POOL_FRAMES)

    def copied(self, data: NDArray[np.uint8]) -> Copied:
        """Copy a buffer, so that it can be given back: its picture, and what is wrong with that."""
        return picture(data, self._grant.layout, self._pool, self._source)

    def frames(self, lent: Lent, received_ns: int, copied: Copied) -> tuple[Frame, ...]:
        """Make the frame, or the fields, of a copied buffer."""
        grant, number = self._grant, self._numbers.extend(lent.sequence)
        stamp_ns = self._stamp_ns(lent, received_ns, number)
        field, defect = self._field(lent)
        frame = Frame(
            pixels=copied[0],
            sequence=self._made if self._own_numbers else number,
            timestamp_ns=stamp_ns,
            received_ns=received_ns,
            field=field,
            pixel_format=grant.granted.pixel_format,
            source=self._source,
            generation=self._generation,
            defect=self._flaw(lent, stamp_ns) or copied[1] or defect,
        )
        self._made += 1
        if not grant.split:
            return (frame,)
        return field_frames(frame, self._field_mode, top_first=grant.top_first, field_ns=grant.field_ns)

    def _stamp_ns(self, lent: Lent, received_ns: int, number: int) -> int:
        """When the exposure ended; of a woven frame, that of its first field."""
        self.missed_by_time = 0
        if lent.stamp_ns is None:
            return received_ns
        stamp_ns = self._stamps.check(lent.stamp_ns, received_ns)
        self.missed_by_time = self._gaps.missing(number, stamp_ns)
        ends_with_second = lent.field not in SINGLE_FIELDS and not lent.stamped_at_start
        return stamp_ns - self._grant.field_ns if ends_with_second else stamp_ns

    def _field(self, lent: Lent) -> tuple[Field, str | None]:
        if self._field_mode is FieldMode.FRAME or self._grant.split:
            return self._grant.granted.field, None
        if lent.field in SINGLE_FIELDS:
            return SINGLE_FIELDS[lent.field], None
        return Field.UNKNOWN, "does not say which field it is"

    def _flaw(self, lent: Lent, stamp_ns: int) -> str | None:
        if lent.flawed:
            return "the device marked it as bad"
        if stamp_ns < self.unsettled_until_ns:
            return "was taken while the input was switched"
        return None
