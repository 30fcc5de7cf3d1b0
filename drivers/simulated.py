"""A capture device that is not there: a rendered tubesheet, four inputs, and every fault on request."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NoReturn

import numpy as np

from drivers.errors import DeviceDisconnectedError, DeviceNotFoundError, DeviceStateError, DeviceTimeoutError
from drivers.fields import field_frames
from drivers.frame import Field, Frame, PixelFormat
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
from drivers.recordings import depth
from drivers.sequence import SequenceExtender
from drivers.simulated_device import Record, SimulatedDevice
from drivers.simulated_pictures import CHANNELS, NEUTRAL, SIGNALLESS, PictureLoop

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.faults import Fault
    from drivers.frame import Pixels
    from drivers.simulated_device import Exposure
    from drivers.simulation import Scene

__all__ = ["SimulatedGrabber"]

STANDARDS: Final = {Standard.NTSC: 30000 / 1001, Standard.PAL: 25.0}
INPUTS: Final = tuple(Input(f"CH{i + 1}", "composite", (Standard.NONE, *STANDARDS)) for i in range(CHANNELS))
CONTROLS: Final = tuple(Control(n, 0, 255, 1, NEUTRAL) for n in ("brightness", "contrast", "hue", "saturation"))


class SimulatedGrabber(Grabber):
    """Serves a loop of rendered pictures as a live device would, and its faults.

    The first `open` renders `loop_frames` pictures; they are shown there and back without end, with their noise. CH1 to
    CH3 show the loop from different places on; CH4 has no signal and is black. A reader who is late by more than
    `buffers` frames loses some, as on a real device.

    Parameters
    ----------
    scene
        What it sees; its `rate_hz` is the device's own pace.
    loop_frames
        Pictures rendered. For a loop without a jolt the trajectory comes to rest there (`default_scene`'s `frames` is
        one less).
    speed
        1.0 is the scene's pace, 2.0 twice that; infinity delivers as fast as it is read.
    buffers
        Frames the device holds for a late reader.
    faults
        What goes wrong, and when.
    rng
        For pictures that are noise.
    field_mode
        Woven frames, or fields.
    name
        What frames and errors call it.
    clock
        Its time.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        loop_frames: int = 48,
        speed: float = 1.0,
        buffers: int = 4,
        faults: Sequence[Fault] = (),
        rng: np.random.Generator | None = None,
        field_mode: FieldMode = FieldMode.FRAME,
        name: str = "simulated",
        clock: Clock | None = None,
    ) -> None:
        super().__init__(name, clock=clock)
        if not speed > 0 or loop_frames < 1 or buffers < 1:
            raise ValueError(f"speed = {speed}, loop_frames = {loop_frames}, buffers = {buffers}: must be above 0")
        self.scene = scene
        self._speed, self._field_mode = speed, field_mode
        self._device = SimulatedDevice(faults, buffers=buffers)
        self._loop = PictureLoop(scene, loop_frames, rng or np.random.default_rng(0))
        self._standard = Standard.NONE
        self._settings = {c.name: c.default for c in CONTROLS}
        self._numbers = SequenceExtender()
        self._pending: deque[Frame] = deque()

    # -- what it shows and did ---------------------------------------------------------------------------------------

    @property
    def record(self) -> Record:
        """The device's own exact account."""
        return self._device.record

    def scene_number(self, pixels: Pixels) -> int | None:
        """Frame of the scene that a delivered picture shows, for its true pose; None for one that was changed."""
        return self._loop.scene_number(pixels)

    # -- format, inputs, controls ------------------------------------------------------------------------------------

    @property
    def format(self) -> FrameFormat:
        """The format granted: a field's where single fields are asked for."""
        optics, mode = self.scene.optics, self._field_mode
        height, field = optics.height_px, Field.INTERLACED_TOP_FIRST if self.scene.interlaced else Field.PROGRESSIVE
        if mode is not FieldMode.FRAME:
            field = Field.BOTTOM if mode is FieldMode.BOTTOM else Field.TOP
            height = (height + (field is Field.TOP)) // 2
        rate_hz = None if math.isinf(self._speed) else self._rate_hz * self._speed
        pixel_format = PixelFormat.MONO8 if self.scene.bits == 8 else PixelFormat.MONO16
        return FrameFormat(optics.width_px, height, pixel_format, "simulated", rate_hz, field)

    @property
    def _rate_hz(self) -> float:
        return STANDARDS.get(self._standard, self.scene.rate_hz)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Four, as the Meteor-MC4 had."""
        return INPUTS

    @property
    def input(self) -> str:
        """Name of the input in use."""
        return INPUTS[self._device.channel].name

    def select_input(self, name: str) -> None:
        """Switch to an input, also while streaming: the next frame exposed is from there."""
        names = [i.name for i in INPUTS]
        if name not in names:
            raise self._unsupported("input", name, names)
        self._device.channel = names.index(name)

    def signal_status(self) -> SignalStatus:
        """Whether the input in use has a signal."""
        return SignalStatus.NO_SIGNAL if self._device.channel == SIGNALLESS else SignalStatus.OK

    @property
    def standard(self) -> Standard:
        """Television standard in use; NONE for the scene's own pace."""
        return self._standard

    def set_standard(self, standard: Standard) -> None:
        """Choose a standard, and its frame rate with it; only while nothing streams."""
        self._require_idle("the standard")
        offered = list(INPUTS[self._device.channel].standards)
        if standard not in offered:
            raise self._unsupported("standard", standard, list(map(str, offered)))
        self._standard = standard

    @property
    def field_mode(self) -> FieldMode:
        """How interlaced video is handed over."""
        return self._field_mode

    def set_field_mode(self, mode: FieldMode) -> None:
        """Choose how interlaced video is handed over; only while nothing streams."""
        self._require_idle("the field mode")
        self._field_mode = mode

    def _require_idle(self, what: str) -> None:
        if self._state is GrabberState.STREAMING:
            raise DeviceStateError(self.name, f"streams; stop it before changing {what}")

    def controls(self) -> tuple[Control, ...]:
        """Brightness and contrast show in the picture; hue and saturation are kept, a grey picture has neither."""
        return CONTROLS

    def control(self, name: str) -> float:
        """Read a setting back."""
        if name not in self._settings:
            raise self._unsupported("control", name, list(self._settings))
        return self._settings[name]

    def set_control(self, name: str, value: float) -> float:
        """Change a setting, rounded and clamped to its range; gives what was taken."""
        control = next((c for c in CONTROLS if c.name == name), None)
        if control is None or math.isnan(value):
            raise self._unsupported("control", f"{name}={value}", list(self._settings))
        self._settings[name] = float(round(min(max(value, control.minimum), control.maximum)))
        self._loop.adjust(self._settings["brightness"], self._settings["contrast"])
        return self._settings[name]

    # -- hooks -------------------------------------------------------------------------------------------------------

    def _do_open(self) -> None:
        back_ns = self._device.gone_until_ns
        if back_ns is not None and self.clock.monotonic_ns() < back_ns:
            wait_s = (back_ns - self.clock.monotonic_ns()) / 1e9
            raise DeviceNotFoundError(self.name, f"is unplugged; it is back in {wait_s:.3f} s")
        self._device.gone_until_ns = None
        self._loop.render()

    def _do_close(self) -> None:
        self._do_stop()

    def _do_start(self, mode: AcquisitionMode) -> None:
        self._numbers.restart()
        self._device.start(
            self.clock.monotonic_ns(), self._period_ns, mode.frames_owed, paced=not math.isinf(self._speed)
        )

    @property
    def _period_ns(self) -> int:
        return round(1e9 / self._rate_hz / (1 if math.isinf(self._speed) else self._speed))

    def _do_stop(self) -> None:
        self._pending.clear()
        self._device.stop()

    def _do_trigger(self) -> None:
        self._device.trigger(self.clock.monotonic_ns())

    def _do_read(self, timeout_s: float) -> Frame:
        deadline_ns = self.clock.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            now_ns = self.clock.monotonic_ns()
            if not self._pending:
                exposure = self._device.take(now_ns)
                if self._device.gone_until_ns is not None:
                    raise DeviceDisconnectedError(self.name, "was unplugged; close it, plug it in and open it again")
                if exposure is not None:
                    self._pending.extend(self._frames(exposure))
            wakes_ns = self._pending_ready_ns() if self._pending else self._device.wakes_ns()
            if self._pending and wakes_ns <= now_ns:
                return replace(self._pending.popleft(), received_ns=now_ns)
            if wakes_ns > deadline_ns:
                self._time_out(deadline_ns - now_ns, timeout_s)
            self.clock.sleep((wakes_ns - now_ns) / 1e9)

    def _pending_ready_ns(self) -> float:
        return 0 if math.isinf(self._speed) else self._pending[0].timestamp_ns

    def _time_out(self, left_ns: float, timeout_s: float) -> NoReturn:
        self.clock.sleep(left_ns / 1e9)
        raise DeviceTimeoutError(self.name, f"no frame within {timeout_s:g} s")

    def _frames(self, exposure: Exposure) -> tuple[Frame, ...]:
        pixels, defect = self._loop.picture(exposure)
        frame = Frame(
            pixels=pixels,
            sequence=self._numbers.extend(exposure.sequence),
            timestamp_ns=exposure.timestamp_ns,
            received_ns=0,
            field=Field.INTERLACED_TOP_FIRST if self.scene.interlaced else Field.PROGRESSIVE,
            pixel_format=depth(pixels),
            source=self.name,
            generation=self.generation,
            defect=defect,
        )
        return field_frames(frame, self._field_mode, top_first=True, field_ns=self._period_ns // 2)
