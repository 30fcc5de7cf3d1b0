"""Which video device is which, by what survives a replug: read from the system's device tree, nothing is opened.

Video nodes of the kernel and USB video devices, which may have no node, are known by the same identities:

- ``usb-534d:2109-A1``: vendor, product and serial number, where no other device has the same;
- ``path-pci-0000:00:14.0-usb-0:1.2``: USB controller, its root hub, and the ports from there, where it has none;
- ``path-platform-vivid.0``, ``path-pci-0000:03:00.0``: the place of a board that is no USB device.

A device with several video nodes has ``#1``, ``#2`` ... behind it for those after the first.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = [
    "SYSFS",
    "UsbDevice",
    "VideoNode",
    "find_usb_devices",
    "find_video_nodes",
    "usb_video_devices",
    "video_nodes",
]

SYSFS: Final = Path("/sys")
VIDEO_CLASS: Final = "0e"


@dataclass(frozen=True, slots=True)
class VideoNode:
    """A video node as the system shows it.

    Attributes
    ----------
    node
        Where it is now, such as /dev/video0. Another one after a replug.
    name
        What it calls itself.
    identity
        What it is best known by.
    place
        Where it is plugged in: an identity too, which another device takes over with its place.
    serial
        Its identity by serial number, where it has one; other devices may have the same.
    ordinal
        Which of its device's nodes it is.
    """

    node: str
    name: str
    identity: str
    place: str
    serial: str | None
    ordinal: int


def video_nodes(sysfs: Path = SYSFS) -> list[VideoNode]:
    """Video nodes of the kernel, in the order of their numbers. Not all are for capture."""
    found = [_Seen.at(folder) for folder in _entries(sysfs / "class/video4linux", "video*")]
    places: dict[str, list[_Seen]] = defaultdict(list)
    for seen in found:
        places[seen.place].append(seen)
    owners = Counter(serial for of_place in places.values() for serial in {seen.serial for seen in of_place})
    nodes = []
    for of_place in places.values():
        for ordinal, seen in enumerate(sorted(of_place, key=lambda seen: seen.order)):
            known_by = seen.serial if seen.serial and owners[seen.serial] == 1 else seen.place
            identity = f"{known_by}#{ordinal}" if ordinal else known_by
            nodes.append(VideoNode(f"/dev/{seen.node}", seen.name, identity, seen.place, seen.serial, ordinal))
    return sorted(nodes, key=lambda n: (len(n.node), n.node))


def find_video_nodes(identity: str, sysfs: Path = SYSFS) -> list[VideoNode]:
    """Nodes of the device with an identity, in the order in which its maker put them; none where it is absent.

    They are those of several devices where these have one serial number between them.
    """
    device, _, ordinal = identity.partition("#")
    found = [n for n in video_nodes(sysfs) if device in {n.place, n.serial} and ordinal in {"", str(n.ordinal)}]
    return sorted(found, key=lambda n: (n.place, n.ordinal))


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """A USB device with a video interface.

    Attributes
    ----------
    node
        Where it is now, such as /dev/bus/usb/001/004: bus and address, which a replug changes.
    name
        What it calls itself.
    identity, place, serial
        As those of a `VideoNode`.
    kernel_driver
        Which of the kernel's drivers serves its video; "" where none does.
    descriptors
        Its device and configuration descriptors, as the system read them.
    """

    node: str
    name: str
    identity: str
    place: str
    serial: str | None
    kernel_driver: str
    descriptors: bytes

    @property
    def bus_and_address(self) -> tuple[int, int]:
        """By which it is reached."""
        bus, address = self.node.split("/")[-2:]
        return int(bus), int(address)


def usb_video_devices(sysfs: Path = SYSFS) -> list[UsbDevice]:
    """USB devices with a video interface, in the order of bus and address."""
    folders = [
        _resolved(folder) for folder in _entries(sysfs / "bus/usb/devices", "[0-9]*-*") if ":" not in folder.name
    ]
    found = [device for device in map(_usb_device, folders) if device is not None]
    owners = Counter(device.serial for device in found)
    unique = (replace(d, identity=d.serial) if d.serial and owners[d.serial] == 1 else d for d in found)
    return sorted(unique, key=lambda d: d.node)


def find_usb_devices(identity: str, sysfs: Path = SYSFS) -> list[UsbDevice]:
    """USB video devices with an identity; several where these have one serial number between them."""
    return [d for d in usb_video_devices(sysfs) if identity in {d.place, d.serial}]


def _usb_device(folder: Path) -> UsbDevice | None:
    interfaces = [i for i in sorted(_entries(folder, "*:*")) if _read(i / "bInterfaceClass") == VIDEO_CLASS]
    bus, address = _read(folder / "busnum"), _read(folder / "devnum")
    if not interfaces or not bus.isdecimal() or not address.isdecimal():
        return None
    place, model = _usb_place(folder), f"{_read(folder / 'idVendor')}:{_read(folder / 'idProduct')}"
    name = " ".join(filter(None, (_read(folder / "manufacturer"), _read(folder / "product")))) or model
    drivers = [_resolved(i / "driver").name for i in interfaces if (i / "driver").exists()]
    return UsbDevice(
        node=f"/dev/bus/usb/{int(bus):03}/{int(address):03}",
        name=name,
        identity=place,
        place=place,
        serial=_usb_serial(folder),
        kernel_driver=drivers[0] if drivers else "",
        descriptors=_read_bytes(folder / "descriptors"),
    )


@dataclass(frozen=True, slots=True)
class _Seen:
    node: str
    name: str
    place: str
    serial: str | None
    order: tuple[str, int]

    @classmethod
    def at(cls, folder: Path) -> _Seen:
        hardware = _resolved(folder / "device")
        name, index = _read(folder / "name") or folder.name, _read(folder / "index")
        order = (hardware.name, int(index) if index.isdecimal() else 0)
        usb = _climb(hardware, lambda at: (at / "idVendor").exists())
        if usb is None:
            return cls(folder.name, name, f"path-{_on_bus(hardware)}", None, order)
        return cls(folder.name, name, _usb_place(usb), _usb_serial(usb), order)


def _usb_serial(usb: Path) -> str | None:
    number = _read(usb / "serial")
    model = f"usb-{_read(usb / 'idVendor')}:{_read(usb / 'idProduct')}"
    return f"{model}-{quote(number, safe='')}" if number else None


def _usb_place(usb: Path) -> str:
    """Name the controller, which of its root hubs it is, and the ports; bus numbers change from boot to boot."""
    ports = usb.name.partition("-")[2]
    root = _climb(usb, lambda at: re.fullmatch(r"usb\d+", at.name) is not None)
    if root is None:
        return f"path-usb-{usb.name}"
    hubs = sorted({root.name, *(hub.name for hub in _entries(root.parent, "usb*"))}, key=lambda name: (len(name), name))
    return f"path-{_on_bus(root.parent)}-usb-{hubs.index(root.name)}:{ports}"


def _on_bus(hardware: Path) -> str:
    bus = hardware / "subsystem"
    return f"{_resolved(bus).name}-{hardware.name}" if bus.exists() else hardware.name


def _climb(start: Path, there: Callable[[Path], bool]) -> Path | None:
    return next((at for at in (start, *start.parents) if there(at)), None)


def _entries(folder: Path, pattern: str) -> list[Path]:
    """What a folder holds; nothing where it goes away meanwhile, as on an unplug."""
    try:
        return list(folder.glob(pattern))
    except OSError:
        return []


def _resolved(path: Path) -> Path:
    """Follow a link; as it is where it goes away meanwhile."""
    try:
        return path.resolve()
    except OSError:
        return path


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""
