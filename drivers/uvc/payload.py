"""From payloads as a USB video device sends them to whole frames: pure functions of bytes, and one small state.

Payload headers are those of section 2.4.3.3 of the "USB Device Class Definition for Video Devices" 1.5. A frame ends
with the header that says so, or where the next one begins: the frame identifier (FID) toggles.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["AssembledFrame", "FrameAssembler", "HeaderBit", "PayloadHeader", "payload_header"]


HEADLESS: Final = "a part of it came without a proper header"


class HeaderBit(enum.IntFlag):
    """Bits of the second byte of a payload header."""

    FID = 0x01
    EOF = 0x02
    PTS = 0x04
    SCR = 0x08
    STILL = 0x20
    ERR = 0x40
    EOH = 0x80


@dataclass(frozen=True, slots=True)
class PayloadHeader:
    """Header of a payload.

    Attributes
    ----------
    size_bytes
        Of the header; the rest of the payload is picture.
    bits
        What it says.
    captured
        When the frame began to be captured, in the device's clock, of 32 bits; None where it does not tell.
    sent
        When the payload was sent, in the same clock.
    """

    size_bytes: int
    bits: HeaderBit
    captured: int | None = None
    sent: int | None = None


def payload_header(payload: bytes) -> PayloadHeader | None:
    """Read the header at the beginning of a payload; None where there is no proper one."""
    if len(payload) < 2 or not 2 <= payload[0] <= len(payload):
        return None
    size, bits = payload[0], HeaderBit(payload[1])
    at, captured, sent = 2, None, None
    if bits & HeaderBit.PTS and at + 4 <= size:
        captured = int(struct.unpack_from("<I", payload, at)[0])
        at += 4
    if bits & HeaderBit.SCR and at + 6 <= size:
        sent = int(struct.unpack_from("<I", payload, at)[0])
    return PayloadHeader(size, bits, captured, sent)


@dataclass(slots=True, eq=False)
class AssembledFrame:
    """A frame as it came.

    Attributes
    ----------
    number
        Counted by the frames that began, from 0; those without a byte of picture are missing.
    arrived_ns
        When its first payload was here.
    captured, sent
        As its first payload's header has them.
    flaw
        None, or in words what went wrong on the way.
    """

    arrived_ns: int
    fid: int
    captured: int | None = None
    sent: int | None = None
    number: int = -1
    data: bytearray = field(default_factory=bytearray)
    flaw: str | None = None


class FrameAssembler:
    """Puts frames together, never more than one, and never a longer one than it may be.

    The first frame is passed over where its beginning was missed: a stream may be joined at any time.

    Parameters
    ----------
    least_bytes, most_bytes
        Of a whole frame; the least is 0 where sizes vary.
    opening
        What a whole frame begins with.
    """

    def __init__(self, least_bytes: int, most_bytes: int, opening: bytes = b"") -> None:
        self._least_bytes, self._most_bytes, self._opening = least_bytes, most_bytes, opening
        self._frame: AssembledFrame | None = None
        self._finished_fid: int | None = None
        self._joined = False
        self._begun = 0
        self._within_payload = self._eof = self._headless = self._stray = False

    def skip(self) -> None:
        """Forget the frame that has begun: what is wanted begins later."""
        self._frame = None
        self._joined = False

    def feed(self, data: bytes, arrived_ns: int, *, ends: bool) -> Iterator[AssembledFrame]:
        """Take what was read, and give the frames that it completes: none, one, or two.

        Parameters
        ----------
        data
            A payload or the next part of it.
        arrived_ns
            When it was here.
        ends
            Whether the payload ends with it.
        """
        if self._within_payload:
            picture = b"" if self._headless else data
        elif not data:
            return
        else:
            header = payload_header(data)
            self._headless, self._eof = header is None, header is not None and bool(header.bits & HeaderBit.EOF)
            if header is None:
                self._stray = self._frame is None and self._joined
                self._blame(HEADLESS)
                picture = b""
            else:
                picture = data[header.size_bytes :]
                yield from self._turn_to(header, arrived_ns, carries=bool(picture))
        self._append(picture)
        self._within_payload = not ends
        if ends and self._eof:
            yield from self._finish()

    def _turn_to(self, header: PayloadHeader, arrived_ns: int, *, carries: bool) -> Iterator[AssembledFrame]:
        """Finish the frame before, where the payload is another's, and begin that."""
        fid = int(header.bits & HeaderBit.FID)
        if self._frame is not None and self._frame.fid != fid:
            yield from self._finish()
        if self._frame is None and (carries or fid != self._finished_fid):
            self._frame = AssembledFrame(arrived_ns, fid, header.captured, header.sent)
            self._place_stray(fid)
        if header.bits & HeaderBit.ERR:
            self._blame("the device marked it as bad")

    def _place_stray(self, fid: int) -> None:
        """What came without a header between two frames was one of its own, or the beginning of the later one."""
        if self._stray and fid == self._finished_fid:
            self._begun += 1
        elif self._stray:
            self._blame(HEADLESS)
        self._stray = False

    def _append(self, picture: bytes) -> None:
        if self._frame is None or not picture:
            return
        room = self._most_bytes - len(self._frame.data)
        self._frame.data += picture[:room]
        if len(picture) > room:
            self._blame(f"holds more than {self._most_bytes} bytes")

    def _blame(self, flaw: str) -> None:
        if self._frame is not None:
            self._frame.flaw = self._frame.flaw or flaw

    def _finish(self) -> Iterator[AssembledFrame]:
        frame, self._frame = self._frame, None
        if frame is None:
            return
        self._finished_fid = frame.fid
        whole = len(frame.data) >= self._least_bytes and frame.data.startswith(self._opening)
        if not self._joined and not whole:
            self._joined = True
            return
        self._joined = True
        frame.number = self._begun
        self._begun += 1
        if frame.data:
            yield frame
