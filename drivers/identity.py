"""Which video device is which, by what survives a replug: read from the system's device tree, nothing is opened.

- ``usb-534d:2109-A1``: vendor, product and serial number, where no other device has the same;
- ``path-pci-0000:00:14.0-usb-0:1.2``: USB controller, its root hub, and the ports from there, where it has none;
- ``path-platform-vivid.0``, ``path-pci-0000:03:00.0``: the place of a board that is no USB device.

A device with several video nodes has ``#1``, ``#2`` ... behind it for those after the first.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["SYSFS", "VideoNode", "find_video_nodes", "video_nodes"]

SYSFS: Final = Path("/sys")


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
    found = [_Seen.at(folder) for folder in (sysfs / "class/video4linux").glob("video*")]
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
class _Seen:
    node: str
    name: str
    place: str
    serial: str | None
    order: tuple[str, int]

    @classmethod
    def at(cls, folder: Path) -> _Seen:
        hardware = (folder / "device").resolve()
        name, index = _read(folder / "name") or folder.name, _read(folder / "index")
        order = (hardware.name, int(index) if index.isdecimal() else 0)
        usb = _climb(hardware, lambda at: (at / "idVendor").exists())
        if usb is None:
            return cls(folder.name, name, f"path-{_on_bus(hardware)}", None, order)
        number = _read(usb / "serial")
        model = f"usb-{_read(usb / 'idVendor')}:{_read(usb / 'idProduct')}"
        return cls(folder.name, name, _usb_place(usb), f"{model}-{quote(number, safe='')}" if number else None, order)


def _usb_place(usb: Path) -> str:
    """Name the controller, which of its root hubs it is, and the ports; bus numbers change from boot to boot."""
    ports = usb.name.partition("-")[2]
    root = _climb(usb, lambda at: re.fullmatch(r"usb\d+", at.name) is not None)
    if root is None:
        return f"path-usb-{usb.name}"
    hubs = sorted((hub.name for hub in root.parent.glob("usb*")), key=lambda name: (len(name), name))
    return f"path-{_on_bus(root.parent)}-usb-{hubs.index(root.name)}:{ports}"


def _on_bus(hardware: Path) -> str:
    bus = hardware / "subsystem"
    return f"{bus.resolve().name}-{hardware.name}" if bus.exists() else hardware.name


def _climb(start: Path, there: Callable[[Path], bool]) -> Path | None:
    return next((at for at in (start, *start.parents) if there(at)), None)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
