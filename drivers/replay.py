"""A recording played through the grabber interface: the same code path as a live device."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from drivers.errors import (
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DeviceStateError,
    DeviceTimeoutError,
    EndOfRecordingError,
    UnsupportedFormatError,
)
from drivers.fields import field_frames
from drivers.frame import Field, Frame
from drivers.grabber import AcquisitionMode, Clock, FieldMode, FrameFormat, Grabber, GrabberState
from drivers.recordings import PICTURE_SUFFIXES, PictureRecording, depth, pictures_in
from drivers.video import VideoRecording

if TYPE_CHECKING:
    from collections.abc import Generator

    from drivers.recordings import Picture, Recording

__all__ = ["ReplayGrabber"]


class ReplayGrabber(Grabber):
    """Plays a video, a folder of pictures or a single picture.

    It behaves like a tape: `stop` pauses, `start` goes on where it paused, `close` and `open` rewind. It never drops a
    frame: who reads late gets them late. `timestamp_ns` is the presentation time from the first picture on. A frame's
    field is UNKNOWN: what containers say of interlace means nothing.

    Parameters
    ----------
    path
        Video, folder or picture file.
    speed
        1.0 is the recording's own pace, 2.0 twice that; infinity gives every frame at once.
    loop
        Begin again at the end; times and numbers grow on over the seam.
    rate_hz
        Pictures a second where the recording does not tell (folders, single pictures).
    field_mode
        Woven frames, or fields.
    top_first
        Whether the even rows of an interlaced recording were scanned first.
    name
        What frames and errors call it; the path where None.
    clock
        Where `received_ns` and waiting come from.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        speed: float = 1.0,
        loop: bool = False,
        rate_hz: float = 25.0,
        field_mode: FieldMode = FieldMode.FRAME,
        top_first: bool = True,
        name: str | None = None,
        clock: Clock | None = None,
    ) -> None:
        super().__init__(name or str(path), clock=clock)
        if not speed > 0:
            raise ValueError(f"speed = {speed}: must be above 0")
        if not 0 < rate_hz < math.inf:
            raise ValueError(f"rate_hz = {rate_hz}: must be above 0 and finite")
        self._path, self._speed, self._loop, self._rate_hz = Path(path), speed, loop, rate_hz
        self._field_mode, self._top_first = field_mode, top_first
        self._recording: Recording | None = None
        self._pictures: Generator[Picture] | None = None
        self._pending: deque[tuple[int, Frame]] = deque()
        """Frames, and when on the recording's own clock each is due."""
        self._owed = 0.0
        self._shift_ns = 0
        """What is added to presentation times to get the clock's."""
        self._seam_ns, self._seam_number = 0, 0
        """Time and number of the current pass's first picture."""
        self._next_ns, self._next_number = 0, 0
        self._first_number = 0

    # -- the recording -----------------------------------------------------------------------------------------------

    @property
    def frame_count(self) -> int | None:
        """Pictures in the recording as far as it tells. Valid from `open` on."""
        return self._opened().frame_count

    @property
    def duration_s(self) -> float | None:
        """Playing time at its own pace, s, as far as it tells. Valid from `open` on."""
        return self._opened().duration_s

    @property
    def format(self) -> FrameFormat:
        """The format granted: a field's where single fields are asked for."""
        granted = replace(self._opened().format, field=Field.UNKNOWN)
        if self._field_mode is FieldMode.FRAME:
            return granted
        field = Field.BOTTOM if self._field_mode is FieldMode.BOTTOM else Field.TOP
        return replace(granted, height_px=(granted.height_px + (field is Field.TOP)) // 2, field=field)

    @property
    def field_mode(self) -> FieldMode:
        """How interlaced video is handed over."""
        return self._field_mode

    def set_field_mode(self, mode: FieldMode) -> None:
        """Choose how interlaced video is handed over; only while nothing streams."""
        if self._state is GrabberState.STREAMING:
            raise DeviceStateError(self.name, "streams; stop it before changing the field mode")
        self._field_mode = mode

    def _opened(self) -> Recording:
        if self._recording is None:
            raise DeviceStateError(self.name, "is closed; open it first")
        return self._recording

    # -- hooks -------------------------------------------------------------------------------------------------------

    def _do_open(self) -> None:
        self._recording = self._find()
        self._pictures = self._recording.pictures()
        self._seam_ns = self._seam_number = self._next_ns = self._next_number = 0

    def _find(self) -> Recording:
        path = self._path
        try:
            kind = path.stat()
        except OSError as error:
            raise DeviceNotFoundError(self.name, f"cannot be opened: {error.strerror}; check the path") from error
        if path.is_dir():
            return PictureRecording(pictures_in(path), rate_hz=self._rate_hz, name=self.name)
        if not path.is_file():
            raise UnsupportedFormatError(self.name, "is no file or folder; give a video, a picture or a folder of them")
        if kind.st_size == 0:
            raise UnsupportedFormatError(self.name, "is empty (0 bytes); copy it again")
        if path.suffix.lower() in PICTURE_SUFFIXES:
            return PictureRecording([path], rate_hz=self._rate_hz, name=self.name)
        return VideoRecording(path, name=self.name)

    def _do_close(self) -> None:
        self._recording = None
        self._pending.clear()
        if self._pictures is not None:
            self._pictures.close()
            self._pictures = None

    def _do_start(self, mode: AcquisitionMode) -> None:
        self._owed = mode.frames_owed
        self._first_number = self._next_number
        self._shift_ns = self.clock.monotonic_ns() - self._paced_ns(self._next_ns)

    def _do_stop(self) -> None:
        self._pending.clear()

    def _do_trigger(self) -> None:
        self._owed += 1

    def _do_read(self, timeout_s: float) -> Frame:
        if not self._pending:
            if self._owed < 1:
                self._wait_in_vain(timeout_s, f"nothing to deliver in {self._mode} mode")
            self._fetch()
            self._owed -= 1
        due_ns = self._shift_ns + self._paced_ns(self._pending[0][0])
        wait_s = (due_ns - self.clock.monotonic_ns()) / 1e9
        if wait_s > timeout_s:
            self._wait_in_vain(timeout_s, f"the next frame is due in {wait_s:.3f} s")
        self.clock.sleep(wait_s)
        return replace(self._pending.popleft()[1], received_ns=self.clock.monotonic_ns())

    def _wait_in_vain(self, timeout_s: float, why: str) -> NoReturn:
        self.clock.sleep(timeout_s)
        raise DeviceTimeoutError(self.name, f"no frame within {timeout_s:g} s: {why}")

    def _paced_ns(self, time_ns: int) -> int:
        return round(time_ns / self._speed)

    def _fetch(self) -> None:
        """Bring the next picture into `_pending`, as the frame or the fields it is."""
        picture = self._next_picture()
        time_ns, number = self._seam_ns + picture.time_ns, self._seam_number + picture.number
        period_ns = self._opened().period_ns
        self._next_ns, self._next_number = time_ns + period_ns, number + 1
        frame = self._frame(picture, time_ns, number - self._first_number)
        for field in field_frames(frame, self._field_mode, top_first=self._top_first, field_ns=period_ns // 2):
            self._pending.append((time_ns + field.timestamp_ns - frame.timestamp_ns, field))

    def _frame(self, picture: Picture, time_ns: int, sequence: int) -> Frame:
        """The frame that a picture is, at its time of this playing."""
        return Frame(
            pixels=picture.pixels,
            sequence=sequence,
            timestamp_ns=time_ns,
            received_ns=0,
            field=Field.UNKNOWN,
            pixel_format=depth(picture.pixels),
            source=self.name,
            generation=self.generation,
            defect=picture.defect,
        )

    def _next_picture(self) -> Picture:
        assert self._pictures is not None
        try:
            picture = next(self._pictures, None)
            if picture is None and self._loop:
                self._seam_ns, self._seam_number = self._next_ns, self._next_number
                self._pictures = self._opened().pictures()
                picture = next(self._pictures, None)
        except (DeviceNotFoundError, UnsupportedFormatError) as error:
            raise DeviceDisconnectedError(self.name, f"cannot be read on: {error.message}") from error
        if picture is None:
            raise EndOfRecordingError(f"{self.name}: played to its end")
        return picture
