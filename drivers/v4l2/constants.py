"""Constants of linux/videodev2.h, as far as they are used here; a test holds them against it."""

from __future__ import annotations

import enum
from typing import Final

__all__ = [
    "BT_TIMINGS_TYPE",
    "EVENT_SOURCE_CHANGE",
    "MEMORY_MMAP",
    "SOURCE_RESOLUTION_CHANGED",
    "BufferFlag",
    "BufferType",
    "CapabilityFlag",
    "ControlFlag",
    "ControlId",
    "ControlType",
    "FieldOrder",
    "InputCapability",
    "InputStatus",
    "SelectionTarget",
    "SizeType",
    "StandardBits",
    "fourcc",
    "fourcc_text",
]


def fourcc(text: str) -> int:
    """Number of a four-character code, written as `fourcc_text` writes it."""
    letters, big_endian, _ = text.partition("-BE")
    return int.from_bytes(letters.encode("ascii").ljust(4), "little") | bool(big_endian) << 31


def fourcc_text(number: int) -> str:
    """Give a four-character code as v4l2-ctl writes it: GREY, Y10, Y16-BE."""
    letters = (number & 0x7FFFFFFF).to_bytes(4, "little").decode("latin-1").rstrip()
    return f"{letters}-BE" if number >> 31 else letters


class CapabilityFlag(enum.IntFlag):
    """V4L2_CAP_*."""

    VIDEO_CAPTURE = 0x1
    VIDEO_CAPTURE_MPLANE = 0x1000
    STREAMING = 0x4000000
    DEVICE_CAPS = 0x80000000


class BufferType(enum.IntEnum):
    """V4L2_BUF_TYPE_*."""

    VIDEO_CAPTURE = 1
    VIDEO_OUTPUT = 2


MEMORY_MMAP: Final = 1


class FieldOrder(enum.IntEnum):
    """V4L2_FIELD_*."""

    ANY = 0
    NONE = 1
    TOP = 2
    BOTTOM = 3
    INTERLACED = 4
    SEQ_TB = 5
    SEQ_BT = 6
    ALTERNATE = 7
    INTERLACED_TB = 8
    INTERLACED_BT = 9


class BufferFlag(enum.IntFlag):
    """V4L2_BUF_FLAG_*."""

    ERROR = 0x40
    TIMESTAMP_MONOTONIC = 0x2000
    TIMESTAMP_MASK = 0xE000
    TSTAMP_SRC_SOE = 0x10000
    TSTAMP_SRC_MASK = 0x70000


class InputStatus(enum.IntFlag):
    """V4L2_IN_ST_*."""

    NO_POWER = 0x1
    NO_SIGNAL = 0x2
    NO_H_LOCK = 0x100
    NO_V_LOCK = 0x400
    NO_STD_LOCK = 0x800
    NO_SYNC = 0x10000
    NO_CARRIER = 0x40000


class InputCapability(enum.IntFlag):
    """V4L2_IN_CAP_*."""

    DV_TIMINGS = 0x2
    STD = 0x4


class StandardBits(enum.IntFlag):
    """V4L2_STD_*."""

    PAL = 0xFF
    NTSC = 0xB000
    SECAM = 0xFF0000
    LINES_525 = 0xF900


class SelectionTarget(enum.IntEnum):
    """V4L2_SEL_TGT_*."""

    CROP = 0x0
    CROP_DEFAULT = 0x1
    COMPOSE = 0x100
    COMPOSE_DEFAULT = 0x101


class ControlType(enum.IntEnum):
    """V4L2_CTRL_TYPE_*."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    BUTTON = 4
    INTEGER64 = 5
    CTRL_CLASS = 6
    STRING = 7
    BITMASK = 8
    INTEGER_MENU = 9


class ControlFlag(enum.IntFlag):
    """V4L2_CTRL_FLAG_*."""

    DISABLED = 0x1
    READ_ONLY = 0x4
    INACTIVE = 0x10
    WRITE_ONLY = 0x40
    NEXT_CTRL = 0x80000000


BT_TIMINGS_TYPE: Final = 0
EVENT_SOURCE_CHANGE: Final = 5
SOURCE_RESOLUTION_CHANGED: Final = 1


class SizeType(enum.IntEnum):
    """V4L2_FRMSIZE_TYPE_*."""

    DISCRETE = 1
    CONTINUOUS = 2
    STEPWISE = 3


class ControlId(enum.IntEnum):
    """V4L2_CID_*: the controls that this program knows by name, whatever the device calls them."""

    BRIGHTNESS = 0x980900
    CONTRAST = 0x980901
    SATURATION = 0x980902
    HUE = 0x980903
    AUTO_WHITE_BALANCE = 0x98090C
    GAMMA = 0x980910
    EXPOSURE = 0x980911
    AUTOGAIN = 0x980912
    GAIN = 0x980913
    HUE_AUTO = 0x980919
    WHITE_BALANCE_TEMPERATURE = 0x98091A
    SHARPNESS = 0x98091B
    BACKLIGHT_COMPENSATION = 0x98091C
    AUTOBRIGHTNESS = 0x980920
    EXPOSURE_AUTO = 0x9A0901
    EXPOSURE_ABSOLUTE = 0x9A0902
    EXPOSURE_AUTO_PRIORITY = 0x9A0903
    FOCUS_ABSOLUTE = 0x9A090A
    FOCUS_AUTO = 0x9A090C
    ZOOM_ABSOLUTE = 0x9A090D
    IRIS_ABSOLUTE = 0x9A0911
