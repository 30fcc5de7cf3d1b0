"""A full frame as a field mode hands it over."""

from __future__ import annotations

from dataclasses import replace

from drivers.frame import Field, Frame
from drivers.grabber import FieldMode

__all__ = ["field_frames"]

_ROWS = {Field.TOP: 0, Field.BOTTOM: 1}


def field_frames(frame: Frame, mode: FieldMode, *, top_first: bool, field_ns: int) -> tuple[Frame, ...]:
    """Split a frame into what `mode` asks for, in the order of time; FRAME gives it back as it is.

    Parameters
    ----------
    frame
        Full frame; its `timestamp_ns` is that of the field which comes first.
    mode
        Both fields, one of them, or the frame.
    top_first
        Whether the even rows were scanned first.
    field_ns
        Time from the first field to the second.
    """
    if mode is FieldMode.FRAME:
        return (frame,)
    order = (Field.TOP, Field.BOTTOM) if top_first else (Field.BOTTOM, Field.TOP)
    wanted = order if mode is FieldMode.ALTERNATE else (Field(mode.value),)
    return tuple(_field(frame, field, order.index(field) * field_ns) for field in wanted)


def _field(frame: Frame, field: Field, later_ns: int) -> Frame:
    pixels = frame.pixels[_ROWS[field] :: 2].copy()
    pixels.flags.writeable = False
    return replace(frame, pixels=pixels, field=field, timestamp_ns=frame.timestamp_ns + later_ns)
