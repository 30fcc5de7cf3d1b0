"""VISCA, the serial language of Sony's block cameras: packets as pure functions.

A packet is 3 to 16 bytes: a header (bit 7, sender, receiver), what is said, and FF. The controller is 0, cameras are 1
to 7, and 8 as receiver means all. Only headers and the end have bit 7 set in the packets that are spoken here, so that
the last such byte before an end begins its packet, whatever noise or broken packet stands before it.

Source: Sony FCB and EVI technical manuals, "VISCA/RS-232C commands" and "Block inquiry command list".
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

__all__ = [
    "Kind",
    "LensBlock",
    "ViscaReply",
    "address_set",
    "autofocus",
    "command",
    "digital_zoom",
    "explain_error",
    "inquiry",
    "interface_clear",
    "lens_block",
    "lens_block_inquiry",
    "parse_reply",
    "split_packets",
    "zoom_inquiry",
    "zoom_position",
]

END = 0xFF
SHORTEST, LONGEST = 3, 16
TO_ALL = 8
COMMAND, INQUIRY = 0x01, 0x09
ON, OFF = 0x02, 0x03
ERRORS = {
    0x01: "message length error",
    0x02: "syntax error",
    0x03: "command buffer full",
    0x04: "command cancelled",
    0x05: "no socket to cancel",
    0x41: "command not executable in this state",
}


class Kind(enum.StrEnum):
    """What a reply says. OTHER: broadcasts, and what this driver does not speak."""

    ACK = "ack"
    COMPLETION = "completion"
    ERROR = "error"
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class ViscaReply:
    """A reply: the camera's address (0: a broadcast), what it says, for which socket, and what stands behind that."""

    address: int
    kind: Kind
    socket: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class LensBlock:
    """The answer to the lens block inquiry; positions in the camera's own counts, bits as named."""

    zoom_position: int
    focus_position: int
    autofocus: bool
    digital_zoom: bool
    zoom_executing: bool
    focus_executing: bool
    recall_executing: bool

    @property
    def executing(self) -> bool:
        """Whether anything moves."""
        return self.zoom_executing or self.focus_executing or self.recall_executing


# -- what we say -----------------------------------------------------------------------------------------------------


def command(address: int, *said: int) -> bytes:
    """Make the packet of a command; raises ValueError where there is no such packet."""
    return _packet(address, COMMAND, *said)


def inquiry(address: int, *said: int) -> bytes:
    """Make the packet of an inquiry; raises ValueError where there is no such packet."""
    return _packet(address, INQUIRY, *said)


def _packet(receiver: int, *said: int) -> bytes:
    if not 1 <= receiver <= TO_ALL:
        raise ValueError(f"address {receiver}: cameras have 1 to 7, all of them 8")
    if not SHORTEST <= len(said) + 2 <= LONGEST:
        raise ValueError(f"{len(said) + 2} bytes: a packet has {SHORTEST} to {LONGEST}")
    if END in said:
        raise ValueError("FF ends a packet and cannot stand in it")
    return bytes((0x80 | receiver, *said, END))


def address_set() -> bytes:
    """Ask all cameras of the chain to number themselves."""
    return _packet(TO_ALL, 0x30, 0x01)


def interface_clear() -> bytes:
    """Ask all cameras to forget commands under way."""
    return command(TO_ALL, 0x00, 0x01)


def autofocus(address: int, *, on: bool) -> bytes:
    """Make the command that leaves the focus to the camera, or keeps it where it is."""
    return command(address, 0x04, 0x38, ON if on else OFF)


def digital_zoom(address: int, *, on: bool) -> bytes:
    """Make the command that allows, or forbids, enlarging beyond the optical zoom."""
    return command(address, 0x04, 0x06, ON if on else OFF)


def zoom_inquiry(address: int) -> bytes:
    """Ask for the zoom position."""
    return inquiry(address, 0x04, 0x47)


def lens_block_inquiry(address: int) -> bytes:
    """Ask for all of the lens at once."""
    return inquiry(address, 0x7E, 0x7E, 0x00)


# -- what we hear ----------------------------------------------------------------------------------------------------


def split_packets(data: bytes) -> tuple[list[bytes], bytes]:
    """Cut whole packets out of `data`, leaving out what is none; returns them and the unfinished rest."""
    *chunks, rest = data.split(bytes((END,)))
    packets = [packet for chunk in chunks if (packet := _packet_at_end(chunk))]
    return packets, rest[-(LONGEST - 1) :]


def _packet_at_end(chunk: bytes) -> bytes | None:
    start = max((i for i, byte in enumerate(chunk) if byte & 0x80), default=None)
    if start is None or not SHORTEST <= len(chunk) - start + 1 <= LONGEST:
        return None
    return chunk[start:] + bytes((END,))


def parse_reply(packet: bytes) -> ViscaReply | None:
    """Read a packet that a camera sent to the controller or to all; None where it is no such packet.

    ACK is ``z0 4y FF``, completion ``z0 5y ... FF``, error ``z0 6y cc FF`` with z the address + 8 and y the socket.
    """
    if not SHORTEST <= len(packet) <= LONGEST or packet[-1] != END or not packet[0] & 0x80:
        return None
    sender, receiver = packet[0] >> 4 & 7, packet[0] & 0xF
    if receiver not in (0, TO_ALL):
        return None
    said, payload = packet[1], packet[2:-1]
    kind = {0x40: Kind.ACK, 0x50: Kind.COMPLETION, 0x60: Kind.ERROR}.get(said & 0xF0, Kind.OTHER)
    if receiver == TO_ALL or (kind is Kind.ACK and payload) or (kind is Kind.ERROR and len(payload) != 1):
        kind = Kind.OTHER
    return ViscaReply(sender, kind, said & 0xF, payload)


def explain_error(reply: ViscaReply) -> str:
    """Give an error's meaning in words."""
    code = reply.payload[0]
    return f"{ERRORS.get(code, 'unknown error')} ({code:02X}h)"


def zoom_position(payload: bytes) -> int | None:
    """Read the answer to the zoom inquiry, ``0p 0q 0r 0s``: pqrs. None where it is another one."""
    return _nibbles(payload) if len(payload) == 4 else None


def lens_block(payload: bytes) -> LensBlock | None:
    """Read the answer to the lens block inquiry; None where it is another one.

    ``0z 0z 0z 0z 0n 0n 0f 0f 0f 0f 00 mm ee``: zoom, near limit, focus; mm: autofocus 1, digital zoom 2; ee: executing
    zoom 1, focus 2, memory recall 4.
    """
    if len(payload) != 13:
        return None
    zoom, focus, mode, executing = _nibbles(payload[:4]), _nibbles(payload[6:10]), payload[11], payload[12]
    if zoom is None or focus is None:
        return None
    return LensBlock(
        zoom_position=zoom,
        focus_position=focus,
        autofocus=bool(mode & 1),
        digital_zoom=bool(mode & 2),
        zoom_executing=bool(executing & 1),
        focus_executing=bool(executing & 2),
        recall_executing=bool(executing & 4),
    )


def _nibbles(data: bytes) -> int | None:
    """Put a number together from bytes that hold 4 bits each; None where one holds more."""
    if any(byte > 0xF for byte in data):
        return None
    return int("".join(f"{byte:x}" for byte in data), 16)
