"""Grabs through OpenCV's VideoCapture: the fallback for what no driver of this project's own serves.

It shows no frame numbers and no error flags, and after a pause hands out pictures that are old. So each picture's age
is looked at here, and whether it is another one than the picture before.
"""

from __future__ import annotations

import contextlib
import logging
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from drivers.access import holders, how_to_permit
from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceProtocolError,
    DeviceStateError,
    DeviceTimeoutError,
    UnsupportedFormatError,
)
from drivers.fields import field_frames
from drivers.frame import Field, Frame, PixelFormat
from drivers.freshness import Freshness
from drivers.grabber import AcquisitionMode, Clock, FieldMode, FrameFormat, Grabber, GrabberState
from drivers.identity import SYSFS
from drivers.pool import FramePool, read_only
from drivers.stamps import StampCheck
from drivers.v4l2.constants import fourcc, fourcc_text
from drivers.v4l2.locating import paths_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from drivers.frame import Pixels

__all__ = ["OpenCvGrabber"]

log = logging.getLogger(__name__)

USUAL_PERIOD_NS: Final = 40_000_000
POOL_FRAMES: Final = 16
MOST_PASSED_OVER: Final = 16
"""Old pictures before a fresh one: more than any backend keeps."""
OLDEST_STAMP_NS: Final = 60_000_000_000
LINES_525: Final = (480, 486)
"""Heights of standards whose bottom field comes first."""


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep OpenCV from writing to the terminal: what goes wrong is told by the grabber."""
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


class OpenCvGrabber(Grabber):
    """A camera of OpenCV's.

    Frames have no number. Those passed over because they were old, and repetitions, count as `suspected`; a
    repetition has a defect. Only Video4Linux devices tell when a picture was taken, and can be waited for with a
    timeout once they stream; for others, and in `start`, a call returns when OpenCV's does.

    Parameters
    ----------
    device
        A number as OpenCV counts cameras, an identity as `drivers.identity` gives it, or a device node.
    size_px, encoding, rate_hz
        What to ask for: width and height, a four-character code, frames a second. None: as OpenCV has it,
        which asks for 640x480.
    field_mode
        Woven frames, or fields: whether pictures are woven, OpenCV does not tell.
    name
        What frames and errors call it; `device` where None.
    capture
        What makes a VideoCapture.
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
        capture: Callable[..., Any] = cv2.VideoCapture,
        sysfs: Path = SYSFS,
        clock: Clock | None = None,
    ) -> None:
        super().__init__(name or device, clock=clock)
        self._device, self._make, self._sysfs = device, capture, sysfs
        self._size_px, self._encoding, self._rate_hz, self._field_mode = size_px, encoding, rate_hz, field_mode
        self._capture: Any | None = None
        self._pending: deque[Frame] = deque()
        self._owed = 0.0

    # -- what is there -------------------------------------------------------------------------------------------------

    @property
    def format(self) -> FrameFormat:
        """The format granted: a field's where single fields are asked for."""
        if self._capture is None:
            raise DeviceStateError(self.name, "is closed; open it first")
        if self._field_mode is FieldMode.FRAME:
            return self._granted
        field = Field.BOTTOM if self._field_mode is FieldMode.BOTTOM else Field.TOP
        return replace(self._granted, height_px=self._granted.height_px // 2, field=field)

    @property
    def _top_first(self) -> bool:
        return self._granted.height_px not in LINES_525

    @property
    def _period_ns(self) -> int:
        return round(1e9 / self._granted.rate_hz) if self._granted.rate_hz else USUAL_PERIOD_NS

    @property
    def field_mode(self) -> FieldMode:
        """How interlaced video is handed over."""
        return self._field_mode

    def set_field_mode(self, mode: FieldMode) -> None:
        """Choose how pictures are handed over; only while nothing streams."""
        if self._state is GrabberState.STREAMING:
            raise DeviceStateError(self.name, "streams; stop it before changing the field mode")
        self._field_mode = mode

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    def _do_open(self) -> None:
        index = int(self._device) if self._device.isdecimal() else None
        path = f"/dev/video{index}" if index is not None else paths_of(self._device, self.name, self._sysfs)[0]
        self._node = Path(path)
        if index is None and not self._node.exists():
            raise DeviceNotFoundError(self.name, f"there is no {path}; bowlsight devices lists what there is")
        with _silence():
            capture = self._make(index if index is not None else path)
        if not capture.isOpened():
            capture.release()
            raise self._why_not()
        self._capture = capture
        try:
            self._granted = self._agree(capture)
        except BaseException:
            self._do_close()
            raise
        self._waits = capture.getBackendName() == "V4L2"
        log.info("%s: read through OpenCV (%s): no frame numbers", self.name, capture.getBackendName())

    def _why_not(self) -> DeviceError:
        """Find out why OpenCV does not open it: OpenCV does not tell."""
        if not self._node.exists():
            return DeviceNotFoundError(self.name, "is not there; bowlsight devices lists what there is")
        try:
            self._node.open("rb").close()
        except PermissionError:
            return DevicePermissionError(self.name, f"may not be opened by this user; {how_to_permit(str(self._node))}")
        except OSError as error:
            return DeviceProtocolError(self.name, f"cannot be opened: {error.strerror}")
        if who := holders(str(self._node)):
            return DeviceBusyError(self.name, f"it is in use by {', '.join(map(str, who))}")
        return UnsupportedFormatError(self.name, f"OpenCV cannot read {self._node}; it may be no camera")

    def _agree(self, capture: Any) -> FrameFormat:
        """Ask for what is wanted, and read back what is granted."""
        wishes: list[tuple[int, float]] = [(cv2.CAP_PROP_BUFFERSIZE, 1)]
        if self._encoding:
            wishes.append((cv2.CAP_PROP_FOURCC, fourcc(self._encoding)))
        if self._size_px:
            wishes += zip((cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT), self._size_px, strict=True)
        if self._rate_hz:
            wishes.append((cv2.CAP_PROP_FPS, self._rate_hz))
        for key, value in wishes:
            capture.set(key, value)
        width, height = (int(capture.get(k)) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width <= 0 or height <= 0:
            raise DeviceProtocolError(self.name, f"says that its pictures are {width}x{height} px")
        if self._size_px not in (None, (width, height)):
            log.warning("%s: asked for %dx%d px, it grants %dx%d", self.name, *self._size_px, width, height)
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        encoding = fourcc_text(int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF) or "BGR"
        return FrameFormat(
            width, height, PixelFormat.MONO8, encoding, rate_hz if 0 < rate_hz < 1000 else None, Field.UNKNOWN
        )

    def _do_close(self) -> None:
        if self._capture is not None:
            self._capture.release()
        self._capture = None

    def _do_start(self, mode: AcquisitionMode) -> None:
        self._owed = mode.frames_owed
        self._pending.clear()
        self._pool = FramePool((self._granted.height_px, self._granted.width_px), np.uint8, POOL_FRAMES)
        self._stamps = StampCheck()
        self._freshness = Freshness(self._period_ns, self.clock.monotonic_ns())
        # a change of settings leaves Video4Linux streaming with no buffer to fill, which a first plain call sets right
        self._grab_and_retrieve()

    def _do_stop(self) -> None:
        """Read no more. OpenCV goes on; what it has kept is passed over when it is started again."""
        self._pending.clear()

    def _do_trigger(self) -> None:
        if self._owed < 1:
            self._freshness.want(self.clock.monotonic_ns())
        self._owed += 1

    # -- frames --------------------------------------------------------------------------------------------------------

    def _do_read(self, timeout_s: float) -> Frame:
        if not self._pending:
            deadline_ns = self.clock.monotonic_ns() + round(timeout_s * 1e9)
            if self._owed < 1:
                self.clock.sleep(timeout_s)
                raise DeviceTimeoutError(self.name, f"no frame within {timeout_s:g} s")
            picture, stamp_ns = self._take_fresh(deadline_ns, timeout_s)
            self._hand_over(picture, stamp_ns)
        return self._pending.popleft()

    def _take_fresh(self, deadline_ns: int, timeout_s: float) -> tuple[Any, int | None]:
        """Take the next picture that is not old, and when it was taken; None where that is not told."""
        for _ in range(MOST_PASSED_OVER):
            began_ns = self.clock.monotonic_ns()
            picture = self._take(deadline_ns, timeout_s)
            now_ns = self.clock.monotonic_ns()
            stamp_ns = self._stamp_ns(now_ns)
            if self._freshness.is_fresh(stamp_ns, began_ns, now_ns):
                break
            self._suspect()
        self._freshness.take(now_ns)
        return picture, stamp_ns

    def _take(self, deadline_ns: int, timeout_s: float) -> Any:
        """Wait for a picture and take it as OpenCV gives it, None where that could not decode it."""
        try:
            if self._waits:
                left_ns = max(1, deadline_ns - self.clock.monotonic_ns())
                if not type(self._capture).waitAny([self._capture], left_ns)[0]:  # type: ignore[union-attr]
                    raise DeviceTimeoutError(self.name, f"no frame within {timeout_s:g} s")
        except cv2.error as error:
            raise self._gone_or_broken(error.err or "OpenCV gave up") from error
        return self._grab_and_retrieve()

    def _grab_and_retrieve(self) -> Any:
        """Take a picture; each is retrieved, for until then OpenCV gives the same one again."""
        assert self._capture is not None, "streaming"
        if not self._capture.grab():
            raise self._gone_or_broken("it gives no picture any more")
        there, picture = self._capture.retrieve()
        return picture if there else None

    def _gone_or_broken(self, why: str) -> DeviceError:
        if self._waits and not self._node.exists():
            return DeviceDisconnectedError(
                self.name, "is gone; was it unplugged? Plug it in, close it and open it again"
            )
        return DeviceProtocolError(self.name, f"{why}; close it and open it again")

    def _stamp_ns(self, now_ns: int) -> int | None:
        assert self._capture is not None, "streaming"
        stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6) if self._waits else 0
        return stamp_ns if stamp_ns > 0 and abs(now_ns - stamp_ns) < OLDEST_STAMP_NS else None

    def _luma(self, picture: Any) -> tuple[Pixels, str | None]:
        """Copy the luma of a picture; black where there is none, and what is wrong with it.

        Raises
        ------
        DeviceProtocolError
            It is none of the pictures agreed on.
        """
        memory, expected = self._pool.take(), (self._granted.height_px, self._granted.width_px)
        if picture is None:
            memory.fill(0)
            return read_only(memory), "cannot be decoded"
        if picture.dtype != np.uint8 or picture.shape[:2] != expected:
            raise DeviceProtocolError(
                self.name,
                f"gives {picture.dtype} pictures of {picture.shape[1]}x{picture.shape[0]} px instead of"
                f" {expected[1]}x{expected[0]}; close it and open it again",
            )
        if picture.ndim == 3 and picture.shape[2] == 3:
            cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY, memory)
        else:
            np.copyto(memory, picture.reshape(*expected, -1)[..., 0])
        return read_only(memory), None

    def _hand_over(self, picture: Any, stamp_ns: int | None) -> None:
        received_ns = self.clock.monotonic_ns()
        pixels, defect = self._luma(picture)
        if self._freshness.repeats(pixels, stamp_ns):
            self._suspect()
            defect = defect or "repeats the picture before it"
        frame = Frame(
            pixels=pixels,
            sequence=None,
            timestamp_ns=received_ns if stamp_ns is None else self._stamps.check(stamp_ns, received_ns),
            received_ns=received_ns,
            field=self._granted.field,
            pixel_format=PixelFormat.MONO8,
            source=self.name,
            generation=self.generation,
            defect=defect,
        )
        self._owed -= 1
        field_ns = self._period_ns // 2
        self._pending.extend(field_frames(frame, self._field_mode, top_first=self._top_first, field_ns=field_ns))

    def _suspect(self) -> None:
        self._counters = replace(self._counters, suspected=self._counters.suspected + 1)
