"""From an identity to an open device node."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.errors import DeviceNotFoundError, UnsupportedFormatError
from drivers.failures import told
from drivers.identity import find_video_nodes, video_nodes
from drivers.v4l2 import calls
from drivers.v4l2.calls import Node
from drivers.v4l2.constants import CapabilityFlag

if TYPE_CHECKING:
    from pathlib import Path

    from drivers.v4l2.calls import SystemCalls

__all__ = ["open_node", "paths_of"]


def open_node(system: SystemCalls, device: str, name: str, sysfs: Path) -> Node:
    """Open the first of a device's nodes that captures video.

    Parameters
    ----------
    device
        An identity of `drivers.identity`, or the path of a node.
    name
        What errors call it.

    Raises
    ------
    DeviceNotFoundError
        It is not there, or several have its serial number.
    DeviceError
        A node cannot be opened, or none captures video.
    """
    why_not = ""
    for path in paths_of(device, name, sysfs):
        with told(name, "cannot be opened", path):
            node = Node.open(system, path)
            try:
                why_not = _why_not(node)
            except BaseException:
                node.close()
                raise
        if not why_not:
            return node
        node.close()
    raise UnsupportedFormatError(name, why_not)


def paths_of(device: str, name: str, sysfs: Path) -> list[str]:
    """Device nodes to try, at least one; raises DeviceNotFoundError."""
    if device.startswith("/"):
        return [device]
    found = find_video_nodes(device, sysfs)
    places = sorted({n.place for n in found})
    if not found:
        there = ", ".join(n.identity for n in video_nodes(sysfs)) or "no video device at all"
        raise DeviceNotFoundError(name, f"is not there; there is {there}")
    if len(places) > 1:
        raise DeviceNotFoundError(name, f"is not the only one with that number; name its place: {' or '.join(places)}")
    return [n.node for n in found]


def _why_not(node: Node) -> str:
    """Say why a node is of no use, where it is of none; raises OSError."""
    _, can = calls.capabilities(node)
    if not can & (CapabilityFlag.VIDEO_CAPTURE | CapabilityFlag.VIDEO_CAPTURE_MPLANE):
        return f"{node.path} does not capture video; bowlsight devices lists what does"
    if not can & CapabilityFlag.VIDEO_CAPTURE:
        return f"{node.path} captures in separate planes only, which this version does not read"
    if not can & CapabilityFlag.STREAMING:
        return f"{node.path} does not stream into mapped memory, which this version needs"
    return ""
