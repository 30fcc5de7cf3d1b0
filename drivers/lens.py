"""The lens of a camera: where zoom and focus stand, and whether they move."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

from drivers import visca
from drivers.dialogue import Dialogue
from drivers.errors import DeviceError, DeviceProtocolError, DeviceStateError, DeviceTimeoutError
from drivers.reading import Quality
from drivers.visca import Kind, ViscaReply

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.serial_channel import ByteChannel

__all__ = ["Lens", "LensState", "ViscaLens"]

log = logging.getLogger(__name__)

T = TypeVar("T")

TIMEOUT_S = 0.5
ADMONISH_S = 5.0
MISUSE = (0x01, 0x02)
"""VISCA errors that say we spoke wrongly; all others tell of the camera's state."""


@dataclass(frozen=True, slots=True)
class LensState:
    """What a lens said of itself, at the monotonic time `time_ns`.

    Attributes
    ----------
    quality, reason
        GOOD, or BAD and why in words; then all else is None.
    zoom_position, focus_position
        In the lens's own counts.
    executing
        Whether zoom or focus is under way.
    digital_zoom, autofocus
        Whether they are switched on. With digital zoom on, pictures may be enlarged by what no position tells.
    """

    time_ns: int
    quality: Quality
    reason: str | None = None
    zoom_position: int | None = None
    focus_position: int | None = None
    executing: bool | None = None
    digital_zoom: bool | None = None
    autofocus: bool | None = None


class Lens(Protocol):
    """A lens that tells where it stands. One thread at a time uses it; `abort` may be called from any."""

    @property
    def name(self) -> str:
        """How the log and people call it."""
        ...

    def read(self) -> LensState:
        """Ask it; blocks for a bounded time. A device's failure is an answer of BAD quality, no exception."""
        ...

    def abort(self) -> None:
        """End a `read` under way soon, and all that come after."""
        ...

    def close(self) -> None:
        """Let the device go. May be repeated."""
        ...


class ViscaLens:
    """The lens of a block camera that speaks VISCA.

    Parameters
    ----------
    channel
        The line, usually 9600 8N1.
    address
        The camera's place in the chain.
    autofocus_off, digital_zoom_off
        Switch these off, whenever they are found on: a camera whose power failed comes back with its own settings.
    timeout_s
        Longest wait for one answer; `read` blocks for a dozen of these at worst.
    """

    def __init__(
        self,
        channel: ByteChannel,
        *,
        address: int = 1,
        autofocus_off: bool = True,
        digital_zoom_off: bool = True,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self.name = channel.name
        self._channel, self._address = channel, address
        self._autofocus_off, self._digital_zoom_off = autofocus_off, digital_zoom_off
        self._dialogue = Dialogue(channel, visca.split_packets, timeout_s)
        self._greeted = 0
        self._admonished_ns: int | None = None

    def read(self) -> LensState:
        """Ask for zoom, focus and flags; a device's failure is an answer of BAD quality."""
        try:
            state = self._ask_state()
        except DeviceError as error:
            return LensState(self._channel.clock.monotonic_ns(), Quality.BAD, error.message)
        self._admonish(state)
        return state

    def set_autofocus(self, on: bool) -> None:
        """Leave the focus to the camera, or keep it where it is; raises DeviceError."""
        self._command(visca.autofocus(self._address, on=on))

    def set_digital_zoom(self, on: bool) -> None:
        """Allow or forbid digital zoom; raises DeviceError."""
        self._command(visca.digital_zoom(self._address, on=on))

    def abort(self) -> None:
        """End a `read` under way soon, and all that come after. Safe from any thread."""
        self._channel.abort()

    def close(self) -> None:
        """Let the line go."""
        self._channel.close()

    def _ask_state(self) -> LensState:
        self._greet()
        # In some makers' cameras the block's zoom position has units of its own; the zoom table is for this inquiry's.
        zoom_position = self._inquire(visca.zoom_inquiry(self._address), visca.zoom_position)
        block = self._inquire(visca.lens_block_inquiry(self._address), visca.lens_block)
        return LensState(
            time_ns=self._channel.clock.monotonic_ns(),
            quality=Quality.GOOD,
            zoom_position=zoom_position,
            focus_position=block.focus_position,
            executing=block.executing,
            digital_zoom=block.digital_zoom,
            autofocus=block.autofocus,
        )

    def _greet(self) -> None:
        """On a line just opened, let the chain number itself and forget what was under way; not all cameras answer."""
        if self._greeted == (line := self._channel.connect()):
            return
        for packet in (visca.address_set(), visca.interface_clear()):
            with suppress(DeviceTimeoutError):
                self._dialogue.ask(packet, lambda answer: visca.parse_reply(answer) is not None)
        self._greeted = line

    def _admonish(self, state: LensState) -> None:
        """Switch off what is on and should not be, at most every five seconds."""
        now_ns = self._channel.clock.monotonic_ns()
        if self._admonished_ns is not None and now_ns - self._admonished_ns < ADMONISH_S * 1e9:
            return
        for what, is_on, unwanted, switch in (
            ("autofocus", state.autofocus, self._autofocus_off, self.set_autofocus),
            ("digital zoom", state.digital_zoom, self._digital_zoom_off, self.set_digital_zoom),
        ):
            if is_on and unwanted:
                self._admonished_ns = now_ns
                try:
                    switch(False)
                except DeviceError as error:
                    log.warning("%s; %s stays on", error, what)
                else:
                    log.warning("%s: %s was on; switched off", self.name, what)

    def _inquire(self, packet: bytes, read: Callable[[bytes], T | None]) -> T:
        def is_answer(message: bytes) -> bool:
            reply = self._own(message)
            return reply is not None and (
                reply.kind is Kind.ERROR or (reply.kind is Kind.COMPLETION and read(reply.payload) is not None)
            )

        answer = read(self._checked(self._dialogue.ask(packet, is_answer).message).payload)
        assert answer is not None
        return answer

    def _command(self, packet: bytes) -> None:
        """Give a command and see it completed; not all cameras acknowledge first."""

        def is_heard(message: bytes) -> bool:
            return is_done(message) or ((reply := self._own(message)) is not None and reply.kind is Kind.ACK)

        def is_done(message: bytes) -> bool:
            reply = self._own(message)
            return reply is not None and (
                reply.kind is Kind.ERROR or (reply.kind is Kind.COMPLETION and not reply.payload)
            )

        reply = self._checked(self._dialogue.ask(packet, is_heard).message)
        if reply.kind is Kind.ACK:
            self._checked(self._dialogue.await_reply(is_done).message)

    def _own(self, message: bytes) -> ViscaReply | None:
        reply = visca.parse_reply(message)
        return reply if reply is not None and reply.address == self._address else None

    def _checked(self, message: bytes) -> ViscaReply:
        reply = visca.parse_reply(message)
        assert reply is not None
        if reply.kind is Kind.ERROR:
            kind = DeviceProtocolError if reply.payload[0] in MISUSE else DeviceStateError
            raise kind(self.name, f"the camera refuses: {visca.explain_error(reply)}")
        return reply
