"""Grabs from a USB video class device that no kernel driver serves, through pyusb."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from drivers.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceStateError,
    DeviceTimeoutError,
    UnsupportedFormatError,
)
from drivers.frame import Field
from drivers.grabber import AcquisitionMode, Clock, Control, FieldMode, FrameFormat, Grabber, GrabberState, Input
from drivers.identity import SYSFS
from drivers.uvc.agreement import agree
from drivers.uvc.controls import UvcControls
from drivers.uvc.frames import UvcFrameMaker
from drivers.uvc.inputs import INPUT_SELECT
from drivers.uvc.link import open_link, the_usb_device
from drivers.uvc.negotiation import Wish
from drivers.uvc.payload import FrameAssembler

if TYPE_CHECKING:
    from pathlib import Path

    from drivers.frame import Frame
    from drivers.uvc.agreement import Agreement
    from drivers.uvc.negotiation import Choice

__all__ = ["UvcGrabber"]

log = logging.getLogger(__name__)

MOST_READ_BYTES: Final = 1 << 18
"""At once: the system allows all programs together some megabytes of USB memory."""
JPEG_OPENING: Final = b"\xff\xd8"


class UvcGrabber(Grabber):
    """A USB camera or grabber that sends in bulk.

    Frames are numbered as they begin: the class has no number of its own, so frames that the device left out show in
    their times alone, as `suspected`. There is no queue: what nobody reads stays in the device, which drops what it
    cannot hold. `timestamp_ns` is when the capture of a frame began, where the device tells.

    Parameters
    ----------
    device
        Its identity as `drivers.identity` gives it.
    size_px, encoding, rate_hz
        What to ask for: width and height, a code such as YUYV or MJPG, frames a second. None: as usual for the
        device; of the encodings an exact one.
    field_mode
        Woven frames, or fields.
    name
        What frames and errors call it; `device` where None.
    backend
        pyusb's; None: libusb.
    sysfs
        Where the kernel shows its devices.
    clock
        Where `received_ns` and waiting come from.
    """

    def __init__(
        self,
        device: str,
        *,
        size_px: tuple[int, int] | None = None,
        encoding: str | None = None,
        rate_hz: float | None = None,
        field_mode: FieldMode = FieldMode.FRAME,
        name: str | None = None,
        backend: Any | None = None,
        sysfs: Path = SYSFS,
        clock: Clock | None = None,
    ) -> None:
        super().__init__(name or device, clock=clock)
        self._device, self._backend, self._sysfs = device, backend, sysfs
        self._wish, self._field_mode = Wish(size_px, encoding, rate_hz), field_mode
        self._agreement: Agreement | None = None
        self._settings: UvcControls | None = None
        self._pending: deque[Frame] = deque()
        self._owed = 0.0

    # -- what is there -------------------------------------------------------------------------------------------------

    @property
    def node(self) -> str:
        """The device node it was found at. Valid from `open` on."""
        return self._opened().link.node

    @property
    def format(self) -> FrameFormat:
        """The format granted: a field's where single fields are asked for."""
        return self._described(self._opened().granted.choice)

    @property
    def format_asked(self) -> FrameFormat:
        """The format asked for, which the device may have replaced. Valid from `open` on."""
        asked = self._described(self._opened().asked)
        if self._wish.size_px:
            width, height = self._wish.size_px
            parts = 1 if self._field_mode is FieldMode.FRAME else 2
            asked = replace(asked, width_px=width, height_px=height // parts)
        return replace(asked, rate_hz=self._wish.rate_hz or asked.rate_hz)

    def _described(self, choice: Choice) -> FrameFormat:
        height, field = choice.size.height_px, Field.PROGRESSIVE
        if choice.format.interlaced:
            field = Field.INTERLACED_TOP_FIRST if choice.format.top_first else Field.INTERLACED_BOTTOM_FIRST
        if self._field_mode is not FieldMode.FRAME:
            height, field = height // 2, Field.BOTTOM if self._field_mode is FieldMode.BOTTOM else Field.TOP
        encoding = choice.layout.encoding
        return FrameFormat(choice.size.width_px, height, encoding.pixel_format, encoding.name, choice.rate_hz, field)

    def _opened(self) -> Agreement:
        if self._agreement is None:
            raise DeviceStateError(self.name, "is closed; open it first")
        return self._agreement

    # -- inputs, fields, controls --------------------------------------------------------------------------------------

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The device's video inputs."""
        return (self._agreement.inputs if self._agreement else ()) or (Input(self.name),)

    @property
    def input(self) -> str:
        """Name of the input in use."""
        if self._agreement is None or not self._agreement.inputs:
            return self.inputs[0].name
        link, function, inputs = self._agreement.link, self._agreement.function, self._agreement.inputs
        with link.told("cannot tell its input"):
            pin = link.get(INPUT_SELECT, function.control_interface, 1, entity=function.selector)
        chosen = int.from_bytes(pin, "little")
        if not 1 <= chosen <= len(inputs):
            raise DeviceProtocolError(self.name, f"says that input {chosen} of {len(inputs)} is in use")
        return inputs[chosen - 1].name

    def select_input(self, name: str) -> None:
        """Switch to an input, also while streaming: frames that were being taken have a defect."""
        names = [i.name for i in self.inputs]
        if name not in names:
            raise self._unsupported("input", name, names)
        if name == self.input:
            return
        link, function = self._opened().link, self._opened().function
        with link.told(f"cannot switch to input {name}"):
            pin = bytes([names.index(name) + 1])
            link.set(INPUT_SELECT, function.control_interface, pin, entity=function.selector)
        self._unsettled_until_ns = self.clock.monotonic_ns() + round(1e9 / (self.format.rate_hz or 25.0))

    @property
    def field_mode(self) -> FieldMode:
        """How interlaced video is handed over."""
        return self._field_mode

    def set_field_mode(self, mode: FieldMode) -> None:
        """Choose how interlaced video is handed over; only while nothing streams.

        Raises
        ------
        UnsupportedFormatError
            The device's pictures are progressive.
        """
        if self._state is GrabberState.STREAMING:
            raise DeviceStateError(self.name, "streams; stop it before changing the field mode")
        if self._agreement is not None:
            self._check_fields(mode, self._agreement)
        self._field_mode = mode

    def _check_fields(self, mode: FieldMode, agreement: Agreement) -> None:
        if mode is not FieldMode.FRAME and not agreement.granted.choice.format.interlaced:
            raise UnsupportedFormatError(
                self.name, f"gives progressive pictures, which have no fields; field mode {mode}"
            )

    def controls(self) -> tuple[Control, ...]:
        """The settings the device offers, with their ranges."""
        return self._table().all()

    def control(self, name: str) -> float:
        """Read a setting back from the device."""
        if name not in self._table():
            raise self._unsupported("control", name, [c.name for c in self.controls()])
        return self._table().read(name)

    def set_control(self, name: str, value: float) -> float:
        """Change a setting to the nearest value that the device takes; gives that, read back."""
        if name not in self._table():
            raise self._unsupported("control", f"{name}={value}", [c.name for c in self.controls()])
        return self._table().write(name, value)

    def _table(self) -> UvcControls:
        if self._settings is None:
            self._settings = UvcControls(self._opened().link, self._opened().function)
        return self._settings

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    def _do_open(self) -> None:
        seen = the_usb_device(self._device, self.name, self._sysfs)
        link = open_link(seen, self.name, self._backend)
        try:
            agreement = agree(link, seen.identity, self._wish)
            self._check_fields(self._field_mode, agreement)
        except BaseException:
            link.close()
            raise
        self._agreement = agreement

    def _do_close(self) -> None:
        agreement, self._agreement = self._agreement, None
        self._settings = None
        if agreement is not None:
            agreement.link.close()

    def _do_start(self, mode: AcquisitionMode) -> None:
        agreement, own_numbers = self._opened(), mode is not AcquisitionMode.CONTINUOUS
        granted, clock_hz = agreement.granted, agreement.function.clock_hz
        exact_bytes = granted.choice.layout.size_bytes
        self._assembler = FrameAssembler(exact_bytes, granted.frame_bytes, b"" if exact_bytes else JPEG_OPENING)
        self._maker = UvcFrameMaker(
            self.name, self.generation, granted.choice, self.format, clock_hz, own_numbers=own_numbers
        )
        self._owed = mode.frames_owed
        self._pending.clear()
        self._payload_bytes = self._unsettled_until_ns = 0
        with agreement.link.told("cannot start"):
            agreement.begin()

    def _do_stop(self) -> None:
        self._pending.clear()
        agreement = self._opened()
        try:
            with agreement.link.told("cannot be stopped"):
                agreement.end()
        except DeviceError as error:
            log.info("%s", error)  # it is gone, or begins anew with the next start

    def _do_trigger(self) -> None:
        if self._owed < 1:
            self._assembler.skip()
        self._owed += 1

    # -- frames --------------------------------------------------------------------------------------------------------

    def _do_read(self, timeout_s: float) -> Frame:
        deadline_ns = self.clock.monotonic_ns() + round(timeout_s * 1e9)
        left_s = timeout_s
        while not self._pending:
            self._serve(left_s, deadline_ns)
            left_s = (deadline_ns - self.clock.monotonic_ns()) / 1e9
            if left_s <= 0 and not self._pending:
                raise DeviceTimeoutError(self.name, f"no frame within {timeout_s:g} s")
        return self._pending.popleft()

    def _serve(self, timeout_s: float, deadline_ns: int) -> None:
        """Read a payload, or a part of one, and make frames of what is whole."""
        link, granted, bulk = self._opened().link, self._opened().granted, self._opened().bulk
        size = min(granted.payload_bytes - self._payload_bytes, MOST_READ_BYTES)
        size += -size % bulk.packet_bytes
        with link.told("cannot be read"):
            data = link.read(bulk.endpoint, size, timeout_s)
        now_ns = self.clock.monotonic_ns()
        if data is None:
            return
        self._payload_bytes += len(data)
        # libusb hands over what it has when its time is up: without a short packet the payload goes on
        broken_off = data and len(data) % bulk.packet_bytes == 0 and now_ns >= deadline_ns
        ends = (len(data) < size and not broken_off) or self._payload_bytes >= granted.payload_bytes
        if ends:
            self._payload_bytes = 0
        for assembled in self._assembler.feed(data, now_ns, ends=ends):
            if self._owed >= 1:
                self._hand_over(self._maker.frames(assembled, now_ns, self._field_mode))

    def _hand_over(self, frames: tuple[Frame, ...]) -> None:
        self._owed -= 1
        for frame in frames:
            switched = frame.timestamp_ns < self._unsettled_until_ns and frame.defect is None
            self._pending.append(replace(frame, defect="was taken while the input was switched") if switched else frame)
        c = self._counters
        self._counters = replace(c, suspected=c.suspected + self._maker.missed_by_time)
