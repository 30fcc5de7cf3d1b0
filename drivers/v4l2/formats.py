"""Agreeing with a device on the pictures it delivers: what was asked, what was granted."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from drivers.encodings import ENCODINGS, Layout
from drivers.errors import UnsupportedFormatError
from drivers.frame import Field
from drivers.grabber import FieldMode, FrameFormat
from drivers.v4l2 import calls
from drivers.v4l2.constants import FieldOrder, SelectionTarget, StandardBits, fourcc, fourcc_text
from drivers.v4l2.timings import timings_in_use

if TYPE_CHECKING:
    from drivers.encodings import Encoding
    from drivers.v4l2.calls import Node
    from drivers.v4l2.structs import PixFormat

__all__ = ["Grant", "Wish", "agree"]

log = logging.getLogger(__name__)

SINGLE_FIELDS: Final = {
    FieldMode.ALTERNATE: FieldOrder.ALTERNATE,
    FieldMode.TOP: FieldOrder.TOP,
    FieldMode.BOTTOM: FieldOrder.BOTTOM,
}
WOVEN: Final = {FieldOrder.INTERLACED, FieldOrder.INTERLACED_TB, FieldOrder.INTERLACED_BT}


@dataclass(frozen=True, slots=True)
class Wish:
    """What is asked of the device; None: as the device has it, or as serves best."""

    size_px: tuple[int, int] | None = None
    encoding: str | None = None
    rate_hz: float | None = None
    field_mode: FieldMode = FieldMode.FRAME


@dataclass(frozen=True, slots=True)
class Grant:
    """What device and driver agreed on.

    Attributes
    ----------
    asked
        The pictures asked for.
    granted
        The pictures to be delivered.
    layout
        Of the device's buffers.
    split
        Whether buffers hold woven frames of which the driver makes fields.
    top_first
        Whether the even rows of a woven frame were scanned first.
    field_ns
        Time from the first field of a frame to the second; 0 for progressive pictures.
    """

    asked: FrameFormat
    granted: FrameFormat
    layout: Layout
    split: bool
    top_first: bool
    field_ns: int


@dataclass(frozen=True, slots=True)
class _Signal:
    """What the standard or the timings of the input say: interlaced or not, in which order, how fast, how big."""

    interlaced: bool
    top_first: bool = True
    rate_hz: float | None = None
    size_px: tuple[int, int] | None = None


def agree(node: Node, device: str, wish: Wish) -> Grant:
    """Set the picture format and the frame rate; raises OSError.

    Raises
    ------
    UnsupportedFormatError
        It offers nothing that can be read, not what was asked for, or progressive pictures where fields were asked.
    """
    encoding = _chosen_encoding(node, device, wish.encoding)
    signal = _signal(node)
    size = wish.size_px or signal.size_px or _full_size(calls.pix_format(node))
    pix = _granted(node, device, size, encoding, wish.field_mode, signal)
    rate_hz = _rate_hz(node, wish.rate_hz) or signal.rate_hz
    field_order = FieldOrder(pix.field)
    split = wish.field_mode is not FieldMode.FRAME and field_order in WOVEN
    top_first = field_order is FieldOrder.INTERLACED_TB or (field_order is FieldOrder.INTERLACED and signal.top_first)
    granted = FrameFormat(
        pix.width,
        pix.height // 2 if split else pix.height,
        encoding.pixel_format,
        encoding.name,
        rate_hz,
        _delivered_field(field_order, wish.field_mode, top_first=top_first),
    )
    grant = Grant(
        asked=_asked(granted, size, wish, rate_hz),
        granted=granted,
        layout=Layout(pix.width, pix.height, pix.bytesperline or pix.width * encoding.bytes_per_px, encoding),
        split=split,
        top_first=top_first,
        field_ns=0 if granted.field is Field.PROGRESSIVE or not rate_hz else round(0.5e9 / rate_hz),
    )
    _tell_substitution(device, wish, grant)
    return grant


def _chosen_encoding(node: Node, device: str, asked: str | None) -> Encoding:
    offered = [fourcc_text(number) for number in calls.encodings(node)]
    usable = [name for name in ENCODINGS if name in offered]
    wanted = asked or (usable[0] if usable else None)
    if wanted in usable:
        return ENCODINGS[wanted]
    there = ", ".join(usable) or f"only what cannot be read ({', '.join(offered) or 'nothing'})"
    raise UnsupportedFormatError(device, f"cannot give {wanted or ' or '.join(ENCODINGS)}; it offers {there}")


def _signal(node: Node) -> _Signal:
    bits = calls.standard(node)
    if bits:
        lines_525 = bool(bits & StandardBits.LINES_525)
        # "top or bottom first depends on the standard: M/NTSC bottom first, others top first" (V4L2_FIELD_INTERLACED)
        return _Signal(interlaced=True, top_first=not lines_525, rate_hz=30000 / 1001 if lines_525 else 25.0)
    timings = timings_in_use(node)
    if timings is None:
        return _Signal(interlaced=False)
    size = timings.width_px, timings.height_px
    return _Signal(timings.interlaced, rate_hz=timings.rate_hz or None, size_px=size)


def _full_size(pix: PixFormat) -> tuple[int, int]:
    return pix.width, pix.height * (2 if pix.field in SINGLE_FIELDS.values() else 1)


def _granted(
    node: Node, device: str, size: tuple[int, int], encoding: Encoding, mode: FieldMode, signal: _Signal
) -> PixFormat:
    """Ask for single fields where they are wanted, else or instead for woven frames."""
    woven = FieldOrder.INTERLACED if signal.interlaced else FieldOrder.ANY
    wishes = [(size, woven)]
    if mode is not FieldMode.FRAME:
        wishes = [((size[0], size[1] // 2), SINGLE_FIELDS[mode]), (size, FieldOrder.INTERLACED)]
    # What another program left cut off, or a smaller format left unused, would be missing or black without a word.
    calls.reset_selection(node, SelectionTarget.CROP, SelectionTarget.CROP_DEFAULT)
    for (width, height), field in wishes:
        pix = calls.set_pix_format(node, (width, height), fourcc(encoding.name), field)
        if pix.pixelformat != fourcc(encoding.name):
            raise UnsupportedFormatError(device, f"lists {encoding.name} but grants {fourcc_text(pix.pixelformat)}")
        if pix.field == field or (field == woven and pix.field in {*WOVEN, FieldOrder.NONE}):
            break
    calls.reset_selection(node, SelectionTarget.COMPOSE, SelectionTarget.COMPOSE_DEFAULT)
    if mode is not FieldMode.FRAME and pix.field not in {SINGLE_FIELDS[mode], *WOVEN}:
        raise UnsupportedFormatError(device, f"gives progressive pictures, which have no fields; field mode {mode}")
    if pix.field not in {FieldOrder.NONE, *WOVEN, *SINGLE_FIELDS.values()}:
        raise UnsupportedFormatError(device, f"grants field order {FieldOrder(pix.field).name}, which cannot be read")
    return pix


def _rate_hz(node: Node, wanted_hz: float | None) -> float | None:
    period_s = (wanted_hz and calls.set_frame_period(node, 1 / wanted_hz)) or calls.frame_period_s(node)
    return 1 / period_s if period_s else None


def _delivered_field(order: FieldOrder, mode: FieldMode, *, top_first: bool) -> Field:
    if mode is not FieldMode.FRAME:
        return Field.BOTTOM if mode is FieldMode.BOTTOM else Field.TOP
    if order is FieldOrder.NONE:
        return Field.PROGRESSIVE
    return Field.INTERLACED_TOP_FIRST if top_first else Field.INTERLACED_BOTTOM_FIRST


def _asked(granted: FrameFormat, size: tuple[int, int], wish: Wish, rate_hz: float | None) -> FrameFormat:
    height = size[1] if wish.field_mode is FieldMode.FRAME else size[1] // 2
    return replace(granted, width_px=size[0], height_px=height, rate_hz=wish.rate_hz or rate_hz)


def _tell_substitution(device: str, wish: Wish, grant: Grant) -> None:
    asked, granted = grant.asked, grant.granted
    if wish.size_px and (asked.width_px, asked.height_px) != (granted.width_px, granted.height_px):
        log.warning(
            "%s: asked for %dx%d px, the device grants %dx%d",
            device, asked.width_px, asked.height_px, granted.width_px, granted.height_px,
        )  # fmt: skip
    if wish.rate_hz and granted.rate_hz and abs(granted.rate_hz / wish.rate_hz - 1) > 0.01:
        log.warning("%s: asked for %g frames a second, the device grants %g", device, wish.rate_hz, granted.rate_hz)
