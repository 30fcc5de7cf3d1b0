"""Grabs from a Video4Linux2 device: cameras, USB grabbers, boards."""

from __future__ import annotations

import errno
import logging
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

from drivers.errors import DeviceError, DeviceProtocolError, DeviceStateError, DeviceTimeoutError
from drivers.failures import gone, told
from drivers.grabber import (
    AcquisitionMode,
    Clock,
    Control,
    FieldMode,
    FrameFormat,
    Grabber,
    GrabberState,
    Input,
    SignalStatus,
    Standard,
)
from drivers.identity import SYSFS
from drivers.v4l2 import calls
from drivers.v4l2.controls import ControlTable
from drivers.v4l2.formats import Grant, Wish, agree
from drivers.v4l2.frames import FrameMaker
from drivers.v4l2.inputs import STANDARD_BITS, list_inputs, signal_status, standard_of
from drivers.v4l2.locating import open_node
from drivers.v4l2.ring import BufferRing
from drivers.v4l2.timings import detected_timings, follow_timings, set_timings, timings_in_use

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from pathlib import Path

    from drivers.frame import Frame
    from drivers.v4l2.calls import Node, SystemCalls
    from drivers.v4l2.timings import Timings

__all__ = ["V4l2Grabber"]

log = logging.getLogger(__name__)


class V4l2Grabber(Grabber):
    """A capture device of the kernel's.

    Frames are numbered by the device; in single and triggered mode, where those that nobody asked for are passed
    over, they are numbered here. Devices without a trigger of their own run free: a trigger takes the next frame.

    Parameters
    ----------
    device
        Its identity as `drivers.identity` gives it, or a device node.
    size_px, encoding, rate_hz
        What to ask for: width and height, a four-character code, frames a second. None: as the device has it; of the
        encodings an exact one.
    field_mode
        Woven frames, or fields.
    buffers
        Frames that the device holds for a late reader.
    newest
        Read the newest frame that is there and pass over those before it, which count as lost; otherwise every frame.
    name
        What frames and errors call it; `device` where None.
    system
        The kernel.
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
        buffers: int = 8,
        newest: bool = False,
        name: str | None = None,
        system: SystemCalls | None = None,
        sysfs: Path = SYSFS,
        clock: Clock | None = None,
    ) -> None:
        super().__init__(name or device, clock=clock)
        self._device, self._system, self._sysfs = device, system or calls.LinuxCalls(), sysfs
        self._wish = Wish(size_px, encoding, rate_hz, field_mode)
        self._buffers, self._newest = buffers, newest
        self._node: Node | None = None
        self._grant: Grant | None = None
        self._ring: BufferRing | None = None
        self._maker = FrameMaker(self.name, 0, own_numbers=False)
        self._inputs: tuple[Input, ...] = ()
        self._settings: ControlTable | None = None
        self._pending: deque[Frame] = deque()
        self._owed = 0.0
        self.source_changes = 0
        """How often the device said that its signal changed, since `open`."""

    # -- what is there -------------------------------------------------------------------------------------------------

    @property
    def node(self) -> str:
        """The device node it was found at. Valid from `open` on."""
        return self._opened().path

    @property
    def format(self) -> FrameFormat:
        """The format granted: a field's where single fields are asked for."""
        return self._agreed().granted

    @property
    def format_asked(self) -> FrameFormat:
        """The format asked for, which the device may have replaced. Valid from `open` on."""
        return self._agreed().asked

    def _opened(self) -> Node:
        if self._node is None:
            raise DeviceStateError(self.name, "is closed; open it first")
        return self._node

    def _agreed(self) -> Grant:
        if self._grant is None:
            raise DeviceStateError(self.name, "is closed; open it first")
        return self._grant

    def _told(self, doing: str) -> AbstractContextManager[None]:
        return told(self.name, doing, self._node.path if self._node else self._device)

    # -- inputs, standard, timings -------------------------------------------------------------------------------------

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The device's video inputs."""
        return self._inputs or (Input(self.name),)

    @property
    def input(self) -> str:
        """Name of the input in use."""
        if not self._inputs:
            return self.name
        with self._told("cannot tell its input"):
            return self._inputs[calls.input_index(self._opened())].name

    def select_input(self, name: str) -> None:
        """Switch to an input, also while streaming.

        A device that cannot do so while it streams is stopped for that moment, and its numbers go on; of one that can,
        frames that were being taken have a defect.
        """
        names = [i.name for i in self.inputs]
        if name not in names:
            raise self._unsupported("input", name, names)
        if name != self.input:
            self._switch(f"cannot switch to input {name}", lambda node: calls.select_input(node, names.index(name)))

    def signal_status(self) -> SignalStatus:
        """What the input in use says of its signal."""
        with self._told("cannot tell its signal"):
            node = self._opened()
            return signal_status(node, calls.input_index(node))

    @property
    def standard(self) -> Standard:
        """Television standard in use."""
        with self._told("cannot tell its standard"):
            return standard_of(calls.standard(self._opened()))

    def set_standard(self, standard: Standard) -> None:
        """Choose the television standard of the input in use, also while streaming."""
        offered = next(i.standards for i in self.inputs if i.name == self.input)
        if standard not in offered:
            raise self._unsupported("standard", standard, list(map(str, offered)))
        if standard is not self.standard:
            bits = STANDARD_BITS[standard]
            self._switch(f"cannot take standard {standard}", lambda node: calls.set_standard(node, bits))

    def detected_standard(self) -> Standard | None:
        """Standard of the signal, NONE without one; None where the device cannot tell."""
        with self._told("cannot tell the standard of its signal"):
            bits = calls.query_standard(self._opened())
            return None if bits is None else standard_of(bits)

    @property
    def timings(self) -> Timings | None:
        """Timings in use of a digital input; None for others. `open` sets them to those of the signal."""
        with self._told("cannot tell its timings"):
            return timings_in_use(self._opened())

    def detected_timings(self) -> Timings | None:
        """Timings of the signal; None where there is none."""
        with self._told("cannot tell the timings of its signal"):
            return detected_timings(self._opened())

    def set_timings(self, timings: Timings) -> None:
        """Choose the timings of a digital input, also while streaming."""
        self._switch(f"cannot take timings {timings}", lambda node: set_timings(node, timings))

    def _switch(self, doing: str, change: Callable[[Node], object]) -> None:
        """Make a change that gives other pictures; where it cannot be made while streaming, stop for it."""
        node = self._opened()
        with self._told(doing):
            try:
                change(node)
            except OSError as error:
                if error.errno != errno.EBUSY or self._ring is None:
                    raise
                self._switch_stopped(lambda: change(node))
            else:
                self._switched()

    def _switched(self) -> None:
        if self._ring is None:
            self._agree()
        else:
            self._maker.unsettled_until_ns = self.clock.monotonic_ns() + round(1e9 / (self.format.rate_hz or 25.0))

    def _switch_stopped(self, change: Callable[[], object]) -> None:
        self._end_stream()
        try:
            try:
                change()
            finally:
                self._agree()
                self._begin_stream()
        except (OSError, DeviceError):
            if self._ring is None:
                self._state = GrabberState.FAULTED
            raise

    # -- fields, controls ----------------------------------------------------------------------------------------------

    @property
    def field_mode(self) -> FieldMode:
        """How interlaced video is handed over."""
        return self._wish.field_mode

    def set_field_mode(self, mode: FieldMode) -> None:
        """Choose how interlaced video is handed over; only while nothing streams.

        Raises
        ------
        UnsupportedFormatError
            The device's pictures are progressive.
        """
        if self._state is GrabberState.STREAMING:
            raise DeviceStateError(self.name, "streams; stop it before changing the field mode")
        before, self._wish = self._wish, replace(self._wish, field_mode=mode)
        if self._node is None:
            return
        try:
            self._agree()
        except DeviceError:
            self._wish = before
            self._agree()
            raise

    def controls(self) -> tuple[Control, ...]:
        """The settings the device offers, with their ranges."""
        return self._table().all()

    def control(self, name: str) -> float:
        """Read a setting back from the device."""
        if name not in self._table():
            raise self._unsupported("control", name, [c.name for c in self.controls()])
        with self._told(f"cannot read {name} back"):
            return self._table().read(name)

    def set_control(self, name: str, value: float) -> float:
        """Change a setting to the nearest value that the device takes; gives that, read back."""
        if name not in self._table():
            raise self._unsupported("control", f"{name}={value}", [c.name for c in self.controls()])
        with self._told(f"cannot set {name} = {value:g}"):
            return self._table().write(name, value)

    def _table(self) -> ControlTable:
        if self._settings is None:
            with self._told("cannot list its controls"):
                self._settings = ControlTable(self._opened(), self.name)
        return self._settings

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    def _do_open(self) -> None:
        self._node = open_node(self._system, self._device, self.name, self._sysfs)
        try:
            with self._told("cannot be set up"):
                self._inputs = list_inputs(calls.inputs(self._node))
                follow_timings(self._node, self.name)
                self._agree()
        except BaseException:
            self._do_close()
            raise
        self.source_changes = 0

    def _agree(self) -> None:
        """Agree on the pictures, and ask to be told when the source of the input in use changes."""
        node = self._opened()
        with self._told("cannot agree on a picture format"):
            self._grant = agree(node, self.name, self._wish)
            calls.subscribe_source_change(node, calls.input_index(node))
            calls.source_changes(node)  # those that were made here are no news

    def _do_close(self) -> None:
        self._end_stream()
        if self._node is not None:
            self._node.close()
        self._node = self._grant = self._settings = None
        self._inputs = ()

    def _do_start(self, mode: AcquisitionMode) -> None:
        self._owed = mode.frames_owed
        self._maker = FrameMaker(self.name, self.generation, own_numbers=mode is not AcquisitionMode.CONTINUOUS)
        self._begin_stream()

    def _begin_stream(self) -> None:
        self._maker.begin(self._agreed(), self._wish.field_mode)
        with self._told("cannot start"):
            self._ring = BufferRing(self._opened(), self._buffers)
            try:
                self._ring.start()
            except OSError:
                self._end_stream()
                raise

    def _do_stop(self) -> None:
        self._end_stream()

    def _end_stream(self) -> None:
        self._pending.clear()
        if self._ring is not None:
            self._ring.release()
            self._ring = None

    def _do_trigger(self) -> None:
        ring = self._streaming()
        if self._owed < 1:
            with self._told("cannot be triggered"):
                while (stale := ring.take()) is not None:
                    ring.give_back(stale)
        self._owed += 1

    # -- frames --------------------------------------------------------------------------------------------------------

    def _do_read(self, timeout_s: float) -> Frame:
        deadline_ns = self.clock.monotonic_ns() + round(timeout_s * 1e9)
        with self._told("cannot be read"):
            while not self._pending:
                left_ns = deadline_ns - self.clock.monotonic_ns()
                self._serve(max(0, left_ns) / 1e9)
                if left_ns <= 0 and not self._pending:
                    raise DeviceTimeoutError(self.name, f"no frame within {timeout_s:g} s")
        return self._pending.popleft()

    def _serve(self, timeout_s: float) -> None:
        """Wait for what the device has to say, and see to it."""
        ring = self._streaming()
        ready = ring.wait(timeout_s)
        if ready.event:
            self._look_at_source()
        if ready.frame:
            self._fetch(ring)
        elif ready.gone:
            raise gone(self.name)
        elif ready.failure:
            self._fail(ring)

    def _fail(self, ring: BufferRing) -> NoReturn:
        """Find out what a failure is that waiting told of: taking a buffer says it, once and for all."""
        ring.take()
        raise DeviceProtocolError(self.name, "stopped streaming and does not say why; close it and open it again")

    def _streaming(self) -> BufferRing:
        assert self._ring is not None, "streaming"
        return self._ring

    def _fetch(self, ring: BufferRing) -> None:
        lent = ring.take()
        if lent is None:
            return
        if self._newest:
            lent = ring.newest(lent)
        received_ns = self.clock.monotonic_ns()
        if self._owed < 1:
            ring.give_back(lent)
            return
        copied = self._maker.copied(ring.data(lent))
        ring.give_back(lent)
        self._owed -= 1
        self._pending.extend(self._maker.frames(lent, received_ns, copied))
        c = self._counters
        self._counters = replace(c, suspected=c.suspected + self._maker.missed_by_time)

    # -- events --------------------------------------------------------------------------------------------------------

    def _look_at_source(self) -> None:
        """See what changed about the signal; of other pictures nothing can be read before they are agreed on."""
        node = self._opened()
        changes = calls.source_changes(node)
        if not changes:
            return
        self.source_changes += changes
        found, in_use = self.detected_timings(), self.timings
        log.warning("%s: its signal changed: %s", self.name, found or self.signal_status())
        if found is not None and in_use is not None and not found.like(in_use):
            raise DeviceProtocolError(
                self.name, f"its source changed from {in_use} to {found}; close it and open it again"
            )
