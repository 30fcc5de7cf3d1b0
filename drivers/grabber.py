r"""The interface every capture device is used through.

Lifecycle::

    CLOSED --open--> OPEN --start--> STREAMING --stop--> OPEN --close--> CLOSED
                       \------------- a device's failure -------------> FAULTED --close--> CLOSED

`open`/`close` and `start`/`stop` are separate and may be repeated: a second `stop` or `close` does nothing, and each
goes on to the end although a step of it fails. A grabber belongs to one thread at a time.
"""

from __future__ import annotations

import enum
import math
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, Self

from drivers.errors import DeviceDisconnectedError, DeviceProtocolError, DeviceStateError, EndOfRecordingError
from drivers.frame import Field, Frame, PixelFormat

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import TracebackType

__all__ = [
    "AcquisitionMode",
    "Clock",
    "Control",
    "Counters",
    "FieldMode",
    "FrameFormat",
    "Grabber",
    "GrabberState",
    "Input",
    "SignalStatus",
    "Standard",
    "SystemClock",
]


class Clock(Protocol):
    """Time as an argument."""

    def monotonic_ns(self) -> int:
        """Nanoseconds since an arbitrary start, never going back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return after at least `seconds`; at once where it is not positive."""
        ...


class SystemClock:
    """The machine's own monotonic clock."""

    def monotonic_ns(self) -> int:
        """Nanoseconds of CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Sleep this thread."""
        if seconds > 0:
            time.sleep(seconds)


class GrabberState(enum.StrEnum):
    """Where a grabber is in its lifecycle."""

    CLOSED = "closed"
    OPEN = "open"
    STREAMING = "streaming"
    FAULTED = "faulted"


class AcquisitionMode(enum.StrEnum):
    """What makes the device deliver a frame: every one, the next one only, or one for each `trigger`."""

    CONTINUOUS = "continuous"
    SINGLE = "single"
    TRIGGERED = "triggered"

    @property
    def frames_owed(self) -> float:
        """How many frames `start` asks for, before any `trigger`."""
        return {"continuous": math.inf, "single": 1, "triggered": 0}[self.value]


class FieldMode(enum.StrEnum):
    """How interlaced video is handed over: woven frames, each field on its own, or one of the two only."""

    FRAME = "frame"
    ALTERNATE = "alternate"
    TOP = "top"
    BOTTOM = "bottom"


class SignalStatus(enum.StrEnum):
    """What an input says of its signal. UNKNOWN where the hardware does not tell."""

    OK = "ok"
    NO_SIGNAL = "no-signal"
    NO_LOCK = "no-lock"
    UNKNOWN = "unknown"


class Standard(enum.StrEnum):
    """Television standard of an analogue input; NONE for digital sources and recordings."""

    NONE = "none"
    NTSC = "ntsc"
    PAL = "pal"
    SECAM = "secam"


@dataclass(frozen=True, slots=True)
class Input:
    """One video input of a device."""

    name: str
    kind: str = "camera"
    standards: tuple[Standard, ...] = (Standard.NONE,)


@dataclass(frozen=True, slots=True)
class FrameFormat:
    """The pictures a device was asked for, or delivers."""

    width_px: int
    height_px: int
    pixel_format: PixelFormat
    encoding: str
    """The source's own name of its coding: a V4L2 fourcc, a codec."""
    rate_hz: float | None = None
    field: Field = Field.PROGRESSIVE


@dataclass(frozen=True, slots=True)
class Control:
    """A setting of the device, such as brightness, contrast, hue, saturation, exposure.

    `choices` says what the whole numbers from `minimum` on mean, where it is a menu; "" means nothing.
    """

    name: str
    minimum: float
    maximum: float
    step: float
    default: float
    unit: str = ""
    choices: tuple[str, ...] = ()
    read_only: bool = False


@dataclass(frozen=True, slots=True)
class Counters:
    """What came of the frames since `open`.

    `completed + lost` is the span of the sequence numbers, where none is handed over twice (fields, repeats).
    """

    completed: int = 0
    """Frames handed over, those with a defect among them."""
    lost: int = 0
    """Frames the source numbered but never handed over."""
    corrupt: int = 0
    """Frames handed over with a defect."""
    timeouts: int = 0
    """Reads that ended without a frame."""
    suspected: int = 0
    """Frames that by the times are missing although the numbers have no gap: some devices number what they deliver."""


class Grabber(ABC):
    """A source of frames; subclasses fill in the `_do_` hooks.

    Parameters
    ----------
    name
        How people know the source; it goes into every frame and error.
    clock
        Where `received_ns` and waiting come from.
    """

    def __init__(self, name: str, *, clock: Clock | None = None) -> None:
        self.name = name
        self.clock: Clock = clock or SystemClock()
        self._state = GrabberState.CLOSED
        self._generation = 0
        self._counters = Counters()
        self._mode = AcquisitionMode.CONTINUOUS
        self._last_sequence: int | None = None

    # -- lifecycle ---------------------------------------------------------------------------------------------------

    @property
    def state(self) -> GrabberState:
        """Where the grabber is in its lifecycle."""
        return self._state

    @property
    def generation(self) -> int:
        """How often it was opened."""
        return self._generation

    @property
    def counters(self) -> Counters:
        """What came of the frames since `open`."""
        return self._counters

    def open(self) -> Self:
        """Take the device. Raises DeviceNotFoundError, DeviceBusyError, DevicePermissionError or a sibling."""
        if self._state is not GrabberState.CLOSED:
            raise DeviceStateError(self.name, f"is {self._state} already; close it before opening it again")
        self._do_open()
        self._generation += 1
        self._counters = Counters()
        self._state = GrabberState.OPEN
        return self

    def close(self) -> None:
        """Give the device back, from any state. Never raises for a device that is gone."""
        if self._state is GrabberState.CLOSED:
            return
        try:
            self._stop_streaming()
        finally:
            self._state = GrabberState.CLOSED
            self._do_close()

    def start(self, mode: AcquisitionMode = AcquisitionMode.CONTINUOUS) -> Self:
        """Begin streaming; sequence numbers begin anew."""
        self._require(GrabberState.OPEN, "start")
        self._mode = mode
        self._last_sequence = None
        self._do_start(mode)
        self._state = GrabberState.STREAMING
        return self

    def stop(self) -> None:
        """End streaming; frames not yet read are dropped. Does nothing where nothing streams."""
        self._stop_streaming()

    def _stop_streaming(self) -> None:
        if self._state is GrabberState.STREAMING:
            self._state = GrabberState.OPEN
            self._do_stop()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- frames ------------------------------------------------------------------------------------------------------

    def read(self, timeout_s: float) -> Frame:
        """Wait for the next frame, oldest first.

        Raises
        ------
        DeviceTimeoutError
            Nothing came within `timeout_s`; the call may be repeated.
        DeviceDisconnectedError, DeviceProtocolError
            The device failed; the grabber is FAULTED until closed and opened again.
        EndOfRecordingError
            A recording is at its end.
        DeviceStateError
            Nothing is streaming.
        """
        self._require(GrabberState.STREAMING, "read")
        try:
            frame = self._do_read(timeout_s)
        except TimeoutError:
            self._counters = replace(self._counters, timeouts=self._counters.timeouts + 1)
            raise
        except (DeviceDisconnectedError, DeviceProtocolError):
            self._state = GrabberState.FAULTED
            raise
        self._count(frame)
        return frame

    def __iter__(self) -> Iterator[Frame]:
        """Frames until stopped or at the end of a recording, each waited for at most ten seconds."""
        while self._state is GrabberState.STREAMING:
            try:
                yield self.read(10.0)
            except EndOfRecordingError:
                return

    def grab(self, timeout_s: float) -> Frame:
        """Take one frame: start in single mode, read it, stop."""
        self.start(AcquisitionMode.SINGLE)
        try:
            return self.read(timeout_s)
        finally:
            self.stop()

    def trigger(self) -> None:
        """Ask for one frame in triggered mode."""
        self._require(GrabberState.STREAMING, "trigger")
        if self._mode is not AcquisitionMode.TRIGGERED:
            raise DeviceStateError(self.name, f"streams in {self._mode} mode; start it in triggered mode to trigger it")
        self._do_trigger()

    def _count(self, frame: Frame) -> None:
        c, lost = self._counters, 0
        if frame.sequence is not None:
            if self._last_sequence is not None:
                lost = max(0, frame.sequence - self._last_sequence - 1)
            self._last_sequence = frame.sequence
        self._counters = replace(
            c, completed=c.completed + 1, lost=c.lost + lost, corrupt=c.corrupt + (frame.defect is not None)
        )

    def _require(self, state: GrabberState, call: str) -> None:
        if self._state is not state:
            raise DeviceStateError(self.name, f"cannot {call} while {self._state}; it must be {state}")

    # -- what the Meteor's users had: inputs, standard, fields, controls ----------------------------------------------

    @property
    @abstractmethod
    def format(self) -> FrameFormat:
        """The format granted. Valid from `open` on."""

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The device's video inputs; one for devices that cannot switch."""
        return (Input(self.name),)

    @property
    def input(self) -> str:
        """Name of the input in use."""
        return self.inputs[0].name

    def select_input(self, name: str) -> None:
        """Switch to an input, also while streaming."""
        if name != self.input:
            raise self._unsupported("input", name, [i.name for i in self.inputs])

    def signal_status(self) -> SignalStatus:
        """What the input in use says of its signal."""
        return SignalStatus.UNKNOWN

    @property
    def standard(self) -> Standard:
        """Television standard in use."""
        return Standard.NONE

    def set_standard(self, standard: Standard) -> None:
        """Choose the television standard of an analogue input."""
        if standard is not self.standard:
            raise self._unsupported("standard", standard, [self.standard])

    @property
    def field_mode(self) -> FieldMode:
        """How interlaced video is handed over."""
        return FieldMode.FRAME

    def set_field_mode(self, mode: FieldMode) -> None:
        """Choose how interlaced video is handed over; only while nothing streams."""
        if mode is not self.field_mode:
            raise self._unsupported("field mode", mode, [self.field_mode])

    def controls(self) -> tuple[Control, ...]:
        """The settings the device offers, with their ranges."""
        return ()

    def control(self, name: str) -> float:
        """Read a setting back from the device."""
        raise self._unsupported("control", name, [c.name for c in self.controls()])

    def set_control(self, name: str, value: float) -> float:
        """Change a setting; returns what the device took, read back."""
        raise self._unsupported("control", f"{name}={value}", [c.name for c in self.controls()])

    def _unsupported(self, what: str, asked: object, offered: list[str]) -> DeviceStateError:
        return DeviceStateError(self.name, f"has no {what} {asked!s}; it offers {', '.join(offered) or 'none'}")

    # -- hooks ---------------------------------------------------------------------------------------------------------

    @abstractmethod
    def _do_open(self) -> None: ...

    @abstractmethod
    def _do_close(self) -> None: ...

    @abstractmethod
    def _do_start(self, mode: AcquisitionMode) -> None: ...

    @abstractmethod
    def _do_stop(self) -> None: ...

    @abstractmethod
    def _do_read(self, timeout_s: float) -> Frame: ...

    def _do_trigger(self) -> None:
        raise DeviceStateError(self.name, "cannot be triggered by software")
