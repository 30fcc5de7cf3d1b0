"""Agreeing with an open device on the stream to read: what was asked, what was granted."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.errors import UnsupportedFormatError
from drivers.uvc.descriptors import video_functions
from drivers.uvc.inputs import list_inputs
from drivers.uvc.negotiation import choose, probe_bytes, read_granted

if TYPE_CHECKING:
    from drivers.grabber import Input
    from drivers.uvc.descriptors import Alternate, VideoFunction, VideoStream
    from drivers.uvc.link import UsbLink
    from drivers.uvc.negotiation import Choice, Granted, Wish

__all__ = ["Agreement", "agree", "isochronous_only"]

log = logging.getLogger(__name__)

PROBE, COMMIT = 0x01, 0x02


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """An open device, and what it sends.

    Attributes
    ----------
    function, stream, bulk
        Which of its functions, of that which stream, of that which setting.
    inputs
        Its video inputs; none where it has no choice.
    asked, granted
        The pictures asked for, and those to come.
    """

    link: UsbLink
    function: VideoFunction
    stream: VideoStream
    bulk: Alternate
    inputs: tuple[Input, ...]
    asked: Choice
    granted: Granted

    def begin(self) -> None:
        """Have the device send. Raises OSError."""
        if self.bulk.number:
            self.link.set_alternate(self.stream.interface, self.bulk.number)
        self.link.clear_halt(self.bulk.endpoint)
        self.link.set(COMMIT, self.stream.interface, self.granted.raw)

    def end(self) -> None:
        """Have it stop, as Windows does: the class does not say how to stop a bulk stream. Raises OSError."""
        self.link.clear_halt(self.bulk.endpoint)
        if self.bulk.number:
            self.link.set_alternate(self.stream.interface, 0)


def agree(link: UsbLink, identity: str, wish: Wish) -> Agreement:
    """Find the first stream that the device sends in bulk, and negotiate what it sends.

    Raises
    ------
    UnsupportedFormatError
        It has no such stream, or none that can be read.
    DeviceProtocolError
        It breaks the rules of the class.
    """
    functions = video_functions(link.configuration())
    found = next(((f, s, s.bulk) for f in functions for s in f.streams if s.bulk), None)
    if found is None or found[2] is None:
        isochronous = any(s.alternates for f in functions for s in f.streams)
        raise UnsupportedFormatError(link.name, isochronous_only(identity) if isochronous else "sends no video")
    function, stream, bulk = found
    asked = choose(stream, link.name, wish)
    probe = probe_bytes(function.version, asked)
    with link.told("cannot agree on a picture format"):
        link.set(PROBE, stream.interface, probe)
        answer = link.get(PROBE, stream.interface, len(probe))
    granted = read_granted(answer, stream, asked, link.name)
    _tell_substitution(link.name, wish, asked, granted.choice)
    return Agreement(link, function, stream, bulk, list_inputs(function), asked, granted)


def isochronous_only(identity: str) -> str:
    """Say why a device is refused that sends isochronously only, and what to do."""
    return (
        "sends isochronously only, which cannot be read from user space without gaps: load the kernel's driver"
        f' (sudo modprobe uvcvideo) and set device = "v4l2:{identity}", or take a grabber that Video4Linux knows'
    )


def _tell_substitution(device: str, wish: Wish, asked: Choice, granted: Choice) -> None:
    size_px = wish.size_px or asked.size_px
    rate_hz = wish.rate_hz or asked.rate_hz
    for what, wanted, got in (
        ("px", "{}x{}".format(*size_px), "{}x{}".format(*granted.size_px)),
        ("encoding", asked.layout.encoding.name, granted.layout.encoding.name),
        ("frames a second", f"{rate_hz:.4g}", f"{granted.rate_hz:.4g}"),
    ):
        if wanted != got:
            log.warning("%s: asked for %s %s, the device grants %s", device, wanted, what, got)
