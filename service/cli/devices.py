"""`bowlsight devices`: what this machine has to offer, and what of it can be opened."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.discovery import serial_ports, video_devices

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from drivers.discovery import Device

__all__ = ["run"]

SOURCES = """\
sources that can be opened, with the line for [source] in the station file
  a rendered tubesheet            device = "simulated"
  a video                         device = "PATH"    .mp4 .mkv .avi .nut ...
  a folder of pictures            device = "PATH"    .png .tif .bmp .jpg .pgm
"""


def run(args: argparse.Namespace) -> int:
    """List; returns the exit status."""
    del args
    print(SOURCES)
    _show("video devices that the system shows; this version cannot grab from them yet", video_devices())
    _show('serial ports that the system shows; port = "..." in [lens] or [range_finder]', serial_ports())
    return 0


def _show(title: str, devices: Sequence[Device]) -> None:
    print(title)
    for device in devices:
        print(f"  {device.node:15} {device.name:32} {device.identity}")
    if not devices:
        print("  none")
