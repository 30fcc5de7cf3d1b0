"""What capture and serial devices the machine has, by identities that survive a replug."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from serial.tools import list_ports

from drivers.uvc.description import usb_grabbers
from drivers.v4l2.description import video_devices
from drivers.video_device import VideoDevice

if TYPE_CHECKING:
    from serial.tools.list_ports_common import ListPortInfo

__all__ = ["Device", "VideoDevice", "serial_ports", "usb_grabbers", "video_devices"]

SERIAL_LINKS = Path("/dev/serial")


@dataclass(frozen=True, slots=True)
class Device:
    """A serial port that the system shows.

    Attributes
    ----------
    node
        Where it is now, such as /dev/ttyUSB0. Another one after a replug.
    name
        What it calls itself.
    identity
        The link below /dev/serial that leads to it; where there is none ``usb:VID:PID:SERIAL`` or ``usb:VID:PID@PORT``.
    """

    node: str
    name: str
    identity: str


def serial_ports(links: Path = SERIAL_LINKS) -> list[Device]:
    """Serial ports, in the order of their names; one that tells nothing of itself goes by its name.

    The identity is the link in by-id, which names the adapter; or that in by-path, which names the socket, where two
    adapters say they are the same one: their link in by-id leads now to the one, now to the other.
    """
    ports = sorted(list_ports.comports(), key=lambda port: port.device)
    adapters = Counter(model for model, _ in {(_model(port), _socket(port)) for port in ports})
    return [
        Device(
            p.device,
            "serial port" if p.description == "n/a" else p.description,
            _link(p.device, links, unique=adapters[_model(p)] == 1) or _port_identity(p),
        )
        for p in ports
    ]


def _model(port: ListPortInfo) -> tuple[int | None, int | None, str | None]:
    """What by-id names an adapter by."""
    return port.vid, port.pid, port.serial_number


def _socket(port: ListPortInfo) -> str:
    """Where an adapter is plugged in, or the port itself; an adapter with several ports is one."""
    return port.location.partition(":")[0] if port.location else port.device


def _link(node: str, links: Path, *, unique: bool) -> str | None:
    target = Path(node).resolve()
    for folder in ("by-id", "by-path") if unique else ("by-path",):
        for link in sorted((links / folder).glob("*")):
            if link.resolve() == target:
                return str(link)
    return None


def _port_identity(port: ListPortInfo) -> str:
    if port.vid is None or port.pid is None:
        return port.device if port.hwid == "n/a" else port.hwid
    model = f"usb:{port.vid:04x}:{port.pid:04x}"
    return f"{model}:{port.serial_number}" if port.serial_number else f"{model}@{port.location}"
