"""What the kernel's video devices are and offer: asked of the devices themselves where they may be opened."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from drivers.access import PROC, holders
from drivers.encodings import ENCODINGS
from drivers.errors import DeviceError
from drivers.failures import told
from drivers.grabber import SignalStatus
from drivers.identity import SYSFS, video_nodes
from drivers.v4l2 import calls
from drivers.v4l2.calls import Node
from drivers.v4l2.constants import CapabilityFlag, fourcc, fourcc_text
from drivers.v4l2.inputs import list_inputs, signal_status
from drivers.video_device import OfferedFormat, OfferedInput, VideoDevice

if TYPE_CHECKING:
    from pathlib import Path

    from drivers.v4l2.calls import SystemCalls

__all__ = ["video_devices"]


def video_devices(sysfs: Path = SYSFS, proc: Path = PROC, system: SystemCalls | None = None) -> list[VideoDevice]:
    """Video devices of the kernel that can be grabbed from, or might be if they could be opened."""
    system = system or calls.LinuxCalls()
    found = []
    for seen in video_nodes(sysfs):
        device = VideoDevice(seen.node, seen.name, seen.identity, held_by=tuple(holders(seen.node, proc)))
        try:
            with told(seen.node, "cannot be asked", seen.node):
                described = _asked(system, device)
        except DeviceError as error:
            described = replace(device, problem=error.message)
        if described is not None:
            found.append(described)
    return found


def _asked(system: SystemCalls, device: VideoDevice) -> VideoDevice | None:
    """Describe a device; None for a node that does not capture. Raises OSError."""
    node = Node.open(system, device.node)
    try:
        about, can = calls.capabilities(node)
        if not can & CapabilityFlag.VIDEO_CAPTURE:
            return None
        return replace(device, driver=calls.text(about.driver), inputs=_inputs(node), formats=_formats(node))
    finally:
        node.close()


def _inputs(node: Node) -> tuple[OfferedInput, ...]:
    in_use = calls.input_index(node)
    return tuple(
        OfferedInput(i.name, i.kind, i.standards, index == in_use, _signal(node, index, in_use))
        for index, i in enumerate(list_inputs(calls.inputs(node)))
    )


def _signal(node: Node, index: int, in_use: int) -> SignalStatus:
    return signal_status(node, index) if index == in_use else SignalStatus.UNKNOWN


def _formats(node: Node) -> tuple[OfferedFormat, ...]:
    offered = [fourcc_text(number) for number in calls.encodings(node)]
    return tuple(
        OfferedFormat(name, tuple(calls.frame_sizes(node, fourcc(name)))) for name in ENCODINGS if name in offered
    )
