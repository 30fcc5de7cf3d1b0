"""Structures and request numbers of linux/videodev2.h, as far as they are used here; a test holds them against it."""

from __future__ import annotations

import ctypes
import enum
from ctypes import c_char, c_int, c_int32, c_int64, c_long, c_uint8, c_uint32, c_uint64, c_ulong, c_void_p, sizeof

__all__ = [
    "BtTimings",
    "BufferDescription",
    "Capability",
    "ControlValue",
    "DvTimings",
    "Event",
    "EventSubscription",
    "Format",
    "FormatDescription",
    "FrameInterval",
    "FrameSize",
    "InputDescription",
    "MenuItem",
    "PixFormat",
    "QueryControl",
    "Rectangle",
    "Request",
    "RequestBuffers",
    "Selection",
    "StreamParameters",
]


# -- structures --------------------------------------------------------------------------------------------------------


class Fraction(ctypes.Structure):
    """v4l2_fract."""

    _fields_ = (("numerator", c_uint32), ("denominator", c_uint32))


class Capability(ctypes.Structure):
    """v4l2_capability."""

    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FormatDescription(ctypes.Structure):
    """v4l2_fmtdesc."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class PixFormat(ctypes.Structure):
    """v4l2_pix_format."""

    _fields_ = (
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("bytesperline", c_uint32),
        ("sizeimage", c_uint32),
        ("colorspace", c_uint32),
        ("priv", c_uint32),
        ("flags", c_uint32),
        ("ycbcr_enc", c_uint32),
        ("quantization", c_uint32),
        ("xfer_func", c_uint32),
    )


class _FormatUnion(ctypes.Union):
    _fields_ = (("pix", PixFormat), ("raw_data", c_uint8 * 200), ("_pointers_in_other_members", c_void_p))


class Format(ctypes.Structure):
    """v4l2_format."""

    _fields_ = (("type", c_uint32), ("fmt", _FormatUnion))


class _SizeSteps(ctypes.Structure):
    _fields_ = tuple(
        (name, c_uint32) for name in ("min_width", "max_width", "step_width", "min_height", "max_height", "step_height")
    )


class FrameSize(ctypes.Structure):
    """v4l2_frmsizeenum; a discrete size is its `min_width` and `max_width`, the union's first two members."""

    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("size", _SizeSteps),
        ("reserved", c_uint32 * 2),
    )


class FrameInterval(ctypes.Structure):
    """v4l2_frmivalenum; a discrete interval is its `shortest`, the union's first member."""

    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("type", c_uint32),
        ("shortest", Fraction),
        ("longest", Fraction),
        ("step", Fraction),
        ("reserved", c_uint32 * 2),
    )


class _CaptureParameters(ctypes.Structure):
    _fields_ = (
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", Fraction),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("reserved", c_uint32 * 4),
    )


class _ParametersUnion(ctypes.Union):
    _fields_ = (("capture", _CaptureParameters), ("raw_data", c_uint8 * 200))


class StreamParameters(ctypes.Structure):
    """v4l2_streamparm."""

    _fields_ = (("type", c_uint32), ("parm", _ParametersUnion))


class RequestBuffers(ctypes.Structure):
    """v4l2_requestbuffers."""

    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    )


class _TimeValue(ctypes.Structure):
    _fields_ = (("tv_sec", c_long), ("tv_usec", c_long))


class _TimeCode(ctypes.Structure):
    _fields_ = (("type", c_uint32), ("flags", c_uint32), ("digits", c_uint8 * 4), ("userbits", c_uint8 * 4))


class _BufferMemory(ctypes.Union):
    _fields_ = (("offset", c_uint32), ("userptr", c_ulong))


class BufferDescription(ctypes.Structure):
    """v4l2_buffer."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("timestamp", _TimeValue),
        ("timecode", _TimeCode),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("m", _BufferMemory),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    )


class InputDescription(ctypes.Structure):
    """v4l2_input."""

    _fields_ = (
        ("index", c_uint32),
        ("name", c_char * 32),
        ("type", c_uint32),
        ("audioset", c_uint32),
        ("tuner", c_uint32),
        ("std", c_uint64),
        ("status", c_uint32),
        ("capabilities", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class Rectangle(ctypes.Structure):
    """v4l2_rect."""

    _fields_ = (("left", c_int32), ("top", c_int32), ("width", c_uint32), ("height", c_uint32))


class Selection(ctypes.Structure):
    """v4l2_selection."""

    _fields_ = (
        ("type", c_uint32),
        ("target", c_uint32),
        ("flags", c_uint32),
        ("r", Rectangle),
        ("reserved", c_uint32 * 9),
    )


class ControlValue(ctypes.Structure):
    """v4l2_control."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


class QueryControl(ctypes.Structure):
    """v4l2_queryctrl."""

    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("default_value", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


class _MenuUnion(ctypes.Union):
    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("name", c_char * 32), ("value", c_int64))


class MenuItem(ctypes.Structure):
    """v4l2_querymenu."""

    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("id", c_uint32), ("index", c_uint32), ("item", _MenuUnion), ("reserved", c_uint32))


class BtTimings(ctypes.Structure):
    """v4l2_bt_timings."""

    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (
        *((name, c_uint32) for name in ("width", "height", "interlaced", "polarities")),
        ("pixelclock", c_uint64),
        *((name, c_uint32) for name in ("hfrontporch", "hsync", "hbackporch", "vfrontporch", "vsync", "vbackporch")),
        *((name, c_uint32) for name in ("il_vfrontporch", "il_vsync", "il_vbackporch", "standards", "flags")),
        ("picture_aspect", Fraction),
        ("cea861_vic", c_uint8),
        ("hdmi_vic", c_uint8),
        ("reserved", c_uint8 * 46),
    )


class _TimingsUnion(ctypes.Union):
    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("bt", BtTimings), ("reserved", c_uint32 * 32))


class DvTimings(ctypes.Structure):
    """v4l2_dv_timings."""

    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("type", c_uint32), ("timings", _TimingsUnion))


class _EventUnion(ctypes.Union):
    _fields_ = (("changes", c_uint32), ("data", c_uint8 * 64), ("_long_in_other_members", c_int64))


class _TimeSpec(ctypes.Structure):
    _fields_ = (("tv_sec", c_long), ("tv_nsec", c_long))


class Event(ctypes.Structure):
    """v4l2_event."""

    _fields_ = (
        ("type", c_uint32),
        ("u", _EventUnion),
        ("pending", c_uint32),
        ("sequence", c_uint32),
        ("timestamp", _TimeSpec),
        ("id", c_uint32),
        ("reserved", c_uint32 * 8),
    )


class EventSubscription(ctypes.Structure):
    """v4l2_event_subscription."""

    _fields_ = (("type", c_uint32), ("id", c_uint32), ("flags", c_uint32), ("reserved", c_uint32 * 5))


# -- request numbers ---------------------------------------------------------------------------------------------------


def _request(direction: int, number: int, size: int) -> int:
    """_IOC of asm-generic/ioctl.h, which x86 and ARM use."""
    return direction << 30 | size << 16 | ord("V") << 8 | number


def _iow(number: int, kind: type[ctypes.Structure | ctypes.c_uint64 | c_int]) -> int:
    return _request(1, number, sizeof(kind))


def _ior(number: int, kind: type[ctypes.Structure | ctypes.c_uint64 | c_int]) -> int:
    return _request(2, number, sizeof(kind))


def _iowr(number: int, kind: type[ctypes.Structure | ctypes.c_uint64 | c_int]) -> int:
    return _request(3, number, sizeof(kind))


class Request(enum.IntEnum):
    """VIDIOC_*."""

    QUERYCAP = _ior(0, Capability)
    ENUM_FMT = _iowr(2, FormatDescription)
    G_FMT = _iowr(4, Format)
    S_FMT = _iowr(5, Format)
    REQBUFS = _iowr(8, RequestBuffers)
    QUERYBUF = _iowr(9, BufferDescription)
    QBUF = _iowr(15, BufferDescription)
    DQBUF = _iowr(17, BufferDescription)
    STREAMON = _iow(18, c_int)
    STREAMOFF = _iow(19, c_int)
    G_PARM = _iowr(21, StreamParameters)
    S_PARM = _iowr(22, StreamParameters)
    G_STD = _ior(23, c_uint64)
    S_STD = _iow(24, c_uint64)
    ENUMINPUT = _iowr(26, InputDescription)
    G_CTRL = _iowr(27, ControlValue)
    S_CTRL = _iowr(28, ControlValue)
    QUERYCTRL = _iowr(36, QueryControl)
    QUERYMENU = _iowr(37, MenuItem)
    G_INPUT = _ior(38, c_int)
    S_INPUT = _iowr(39, c_int)
    QUERYSTD = _ior(63, c_uint64)
    ENUM_FRAMESIZES = _iowr(74, FrameSize)
    ENUM_FRAMEINTERVALS = _iowr(75, FrameInterval)
    G_SELECTION = _iowr(94, Selection)
    S_SELECTION = _iowr(95, Selection)
    S_DV_TIMINGS = _iowr(87, DvTimings)
    G_DV_TIMINGS = _iowr(88, DvTimings)
    DQEVENT = _ior(89, Event)
    SUBSCRIBE_EVENT = _iow(90, EventSubscription)
    QUERY_DV_TIMINGS = _ior(99, DvTimings)
