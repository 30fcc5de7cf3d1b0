"""What a USB video device without a kernel driver is and offers, read from what the system knows: it is not opened."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

from drivers.access import PROC, holders, how_to_permit
from drivers.grabber import SignalStatus
from drivers.identity import SYSFS, usb_video_devices
from drivers.uvc.agreement import isochronous_only
from drivers.uvc.descriptors import video_functions
from drivers.uvc.inputs import list_inputs
from drivers.video_device import OfferedFormat, OfferedInput, VideoDevice

if TYPE_CHECKING:
    from pathlib import Path

    from drivers.identity import UsbDevice
    from drivers.uvc.descriptors import VideoFunction, VideoStream

__all__ = ["usb_grabbers"]

DEVICE_DESCRIPTOR_BYTES = 18


def usb_grabbers(sysfs: Path = SYSFS, proc: Path = PROC) -> list[VideoDevice]:
    """USB video devices that no kernel driver serves; those that one does are among the kernel's own."""
    return [_described(seen, proc) for seen in usb_video_devices(sysfs) if not seen.kernel_driver]


def _described(seen: UsbDevice, proc: Path) -> VideoDevice:
    device = VideoDevice(
        seen.node, seen.name, seen.identity, "no kernel driver", held_by=tuple(holders(seen.node, proc)), scheme="uvc"
    )
    functions = video_functions(seen.descriptors[DEVICE_DESCRIPTOR_BYTES:])
    function, stream = next(((f, s) for f in functions for s in f.streams if s.bulk), (None, None))
    if function is None or stream is None:
        isochronous = any(s.alternates for f in functions for s in f.streams)
        return replace(device, problem=isochronous_only(seen.identity) if isochronous else "sends no video")
    return replace(device, inputs=_inputs(function), formats=_formats(stream), problem=_forbidden(seen.node))


def _inputs(function: VideoFunction) -> tuple[OfferedInput, ...]:
    return tuple(
        OfferedInput(i.name, i.kind, i.standards, in_use=False, signal=SignalStatus.UNKNOWN)
        for i in list_inputs(function)
    )


def _formats(stream: VideoStream) -> tuple[OfferedFormat, ...]:
    return tuple(
        OfferedFormat(f.encoding, tuple((s.width_px, s.height_px) for s in f.sizes))
        for f in stream.formats
        if f.encoding
    )


def _forbidden(node: str) -> str | None:
    if os.access(node, os.R_OK | os.W_OK):
        return None
    return f"may not be opened by this user; {how_to_permit(node)}"
