"""`bowlsight devices`: what this machine has to offer, and what of it can be opened."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

from drivers.discovery import serial_ports, usb_grabbers, video_devices
from drivers.grabber import SignalStatus

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from drivers.discovery import Device, VideoDevice
    from drivers.video_device import OfferedFormat, OfferedInput

__all__ = ["run"]

SCHEMA = 1
MOST_SIZES = 6
SOURCES = """\
sources that can be opened, with the line for [source] in the station file
  a rendered tubesheet            device = "simulated"
  a video                         device = "PATH"    .mp4 .mkv .avi .nut ...
  a folder of pictures            device = "PATH"    .png .tif .bmp .jpg .pgm
  a video device                  device = "v4l2:NAME" or, without a kernel driver, "uvc:NAME", as listed below
  a camera through OpenCV         device = "opencv:NAME" or "opencv:0"    the fallback: no frame numbers
"""


def run(args: argparse.Namespace) -> int:
    """List; returns the exit status."""
    videos, ports = [*video_devices(), *usb_grabbers()], serial_ports()
    if args.json:
        print(json.dumps(_as_json(videos, ports), indent=2))
        return 0
    print(SOURCES)
    print("video devices")
    for line in [line for device in videos for line in _video_lines(device)] or ["  none"]:
        print(line)
    _show('\nserial ports; port = "..." in [lens] or [range_finder]', ports)
    return 0


def _as_json(videos: Sequence[VideoDevice], ports: Sequence[Device]) -> dict[str, object]:
    return {
        "schema": SCHEMA,
        "video": [{"device": v.source} | asdict(v) for v in videos],
        "serial": [{"port": p.identity} | asdict(p) for p in ports],
    }


def _video_lines(device: VideoDevice) -> Iterator[str]:
    driver = f" ({device.driver})" if device.driver else ""
    yield f"  {device.node}  {device.name}{driver}"
    yield f'    device = "{device.source}"'
    for offered in device.inputs:
        yield f"    input = {json.dumps(offered.name, ensure_ascii=False)}  {_about(offered)}"
    for offered_format in device.formats:
        yield f"    ?encoding={offered_format.encoding}  {_sizes(offered_format)}"
    if device.held_by:
        yield f"    open in {', '.join(map(str, device.held_by))}"
    if device.problem is not None:
        yield f"    {device.problem}"


def _about(offered: OfferedInput) -> str:
    words = [offered.kind, *(str(s) for s in offered.standards if s != "none")]
    if offered.in_use:
        words.append("in use")
    if offered.signal is not SignalStatus.UNKNOWN:
        words.append(f"signal {offered.signal}")
    return ", ".join(words)


def _sizes(offered: OfferedFormat) -> str:
    sizes = [f"{width}x{height}" for width, height in offered.sizes_px]
    more = f" and {len(sizes) - MOST_SIZES} more" if len(sizes) > MOST_SIZES else ""
    return " ".join(sizes[:MOST_SIZES]) + more


def _show(title: str, devices: Sequence[Device]) -> None:
    print(title)
    for device in devices:
        print(f"  {device.node:15} {device.name:32} {device.identity}")
    if not devices:
        print("  none")
