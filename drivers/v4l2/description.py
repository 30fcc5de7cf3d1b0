"""What a video device is and offers, for people: asked of the device itself where it may be opened."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from drivers.access import PROC, Holder, holders
from drivers.errors import DeviceError
from drivers.grabber import SignalStatus, Standard
from drivers.identity import SYSFS, video_nodes
from drivers.v4l2 import calls
from drivers.v4l2.calls import Node
from drivers.v4l2.constants import CapabilityFlag, fourcc, fourcc_text
from drivers.v4l2.encodings import ENCODINGS
from drivers.v4l2.failures import told
from drivers.v4l2.inputs import list_inputs, signal_status

if TYPE_CHECKING:
    from pathlib import Path

    from drivers.v4l2.calls import SystemCalls

__all__ = ["OfferedFormat", "OfferedInput", "VideoDevice", "video_devices"]


@dataclass(frozen=True, slots=True)
class OfferedInput:
    """An input; `signal` is known of the one in use only."""

    name: str
    kind: str
    standards: tuple[Standard, ...]
    in_use: bool
    signal: SignalStatus


@dataclass(frozen=True, slots=True)
class OfferedFormat:
    """An encoding that can be grabbed, and its sizes in px; the least and the greatest where all between will do."""

    encoding: str
    sizes_px: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class VideoDevice:
    """A video device that captures, or that may not be asked whether it does.

    Attributes
    ----------
    node
        Where it is now.
    name, driver
        What it calls itself, and the kernel's driver.
    identity
        What it is known by, also after a replug.
    inputs, formats
        What it offers.
    held_by
        Processes that have it open.
    problem
        Why it cannot be opened, and what to do; None where it can.
    scheme
        How it is read: "v4l2" through the kernel's driver, "uvc" over USB without one.
    """

    node: str
    name: str
    identity: str
    driver: str = ""
    inputs: tuple[OfferedInput, ...] = ()
    formats: tuple[OfferedFormat, ...] = ()
    held_by: tuple[Holder, ...] = field(default=())
    problem: str | None = None
    scheme: str = "v4l2"

    @property
    def source(self) -> str:
        """How `open_grabber` takes it."""
        return f"{self.scheme}:{self.identity}"


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
