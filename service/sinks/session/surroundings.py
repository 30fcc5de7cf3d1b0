"""What a session was made with: time and its source, software, machine, device."""

from __future__ import annotations

import ctypes
import os
import platform
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from drivers.errors import DeviceError
from drivers.grabber import Standard
from service import __version__

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.grabber import Grabber

__all__ = ["changed", "device", "machine", "software", "utc_source", "utc_text"]

PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "av")
TIMEX_BYTES, MAXERROR_AT, TIME_ERROR = 512, 24, 5
"""struct timex of adjtimex(2) on 64-bit Linux: room for it, where maxerror (us) is; what it gives out of step."""


def utc_text(wall_ns: int) -> str:
    """UTC as 2026-11-22T08:15:30.123Z."""
    seconds, rest_ns = divmod(wall_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest_ns // 1_000_000:03d}Z"


def utc_source() -> str:
    """Where this machine's UTC comes from, and how far it is to be trusted, as far as the kernel tells."""
    try:
        timex = ctypes.create_string_buffer(TIMEX_BYTES)
        state = ctypes.CDLL(None, use_errno=True).adjtimex(timex)
    except (OSError, AttributeError):
        return "system clock"
    if state == TIME_ERROR or state < 0:
        return "system clock, not synchronised"
    error_us = int.from_bytes(timex.raw[MAXERROR_AT : MAXERROR_AT + 8], "little", signed=True)
    return f"system clock, synchronised within {max(1, round(error_us / 1000))} ms"


def software() -> dict[str, str]:
    """Versions of all that has a part in a result."""
    versions = {name: metadata.version(name) for name in PACKAGES}
    return {"bowlsight": __version__, "python": platform.python_version(), "opencv": cv2.__version__, **versions}


def machine() -> dict[str, Any]:
    """The processor, which decides the last digits, and the system."""
    return {"cpu": _cpu(), "cores": os.cpu_count() or 1, "system": platform.platform()}


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.machine())


def changed(recorded: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What is not as it was recorded, in words."""
    return [
        f"{key} {recorded[key]} then, {now[key]} now" for key in recorded if key in now and recorded[key] != now[key]
    ]


def device(grabber: Grabber) -> dict[str, Any]:
    """An open grabber, as it says that it is set."""
    granted = grabber.format
    said: dict[str, Any] = {
        "name": grabber.name,
        "size_px": [granted.width_px, granted.height_px],
        "format": str(granted.pixel_format),
        "encoding": granted.encoding,
        "field": str(granted.field),
        "input": grabber.input,
    }
    if granted.rate_hz is not None:
        said["rate_hz"] = granted.rate_hz
    if grabber.standard is not Standard.NONE:
        said["standard"] = str(grabber.standard)
    return said | {"controls": {control.name: _setting(grabber, control.name) for control in grabber.controls()}}


def _setting(grabber: Grabber, name: str) -> float | str:
    try:
        return grabber.control(name)
    except DeviceError as error:
        return error.message
