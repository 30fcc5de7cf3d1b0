"""Laser range finders: a distance with its sigma, or in words why there is none."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol, TypeAlias

from drivers.dialogue import Dialogue, split_lines
from drivers.errors import DeviceError
from drivers.reading import Quality
from drivers.serial_port import LineSettings

if TYPE_CHECKING:
    from drivers.serial_channel import ByteChannel

__all__ = [
    "AcuityRangeFinder",
    "DimetixRangeFinder",
    "RangeFinder",
    "RangeReading",
    "acuity_answer",
    "dimetix_answer",
]

Answer: TypeAlias = float | str | None
"""A distance, mm; or in words why there is none; or None: the line answers nothing."""

TIMEOUT_S = 1.5
"""A dark or glaring target takes them up to seconds; one that takes longer than this is no help to live video."""


@dataclass(frozen=True, slots=True)
class RangeReading:
    """What a range finder said, at the monotonic time `time_ns`.

    `distance_mm` from its zero along its beam, and `sigma_mm`, where `quality` is GOOD; else None, and why in words.
    """

    time_ns: int
    quality: Quality
    reason: str | None = None
    distance_mm: float | None = None
    sigma_mm: float | None = None


class RangeFinder(Protocol):
    """A range finder. One thread at a time uses it; `abort` may be called from any."""

    @property
    def name(self) -> str:
        """How the log and people call it."""
        ...

    def read(self) -> RangeReading:
        """Measure once; blocks for a bounded time. A device's failure is an answer of BAD quality, no exception."""
        ...

    def abort(self) -> None:
        """End a `read` under way soon, and all that come after."""
        ...

    def close(self) -> None:
        """Let the device go. May be repeated."""
        ...


class _AsciiRangeFinder(ABC):
    """What those have in common that answer a line with a line.

    Parameters
    ----------
    channel
        The line.
    sigma_mm
        One sigma of a distance; None: the type's usual one.
    timeout_s
        Longest wait for an answer; `read` blocks for four times that at worst.
    """

    usual_line: ClassVar[LineSettings]
    usual_sigma_mm: ClassVar[float]

    def __init__(self, channel: ByteChannel, *, sigma_mm: float | None = None, timeout_s: float = TIMEOUT_S) -> None:
        self.name = channel.name
        self._channel = channel
        self._sigma_mm = self.usual_sigma_mm if sigma_mm is None else sigma_mm
        self._dialogue = Dialogue(channel, split_lines, timeout_s)

    @property
    @abstractmethod
    def _question(self) -> bytes:
        """Ask for one measurement."""

    @abstractmethod
    def _do_answer(self, line: bytes) -> Answer:
        """Read a line."""

    def read(self) -> RangeReading:
        """Measure once; a device's failure is an answer of BAD quality."""
        try:
            reply = self._dialogue.ask(self._question, lambda line: self._do_answer(line) is not None)
        except DeviceError as error:
            return RangeReading(self._channel.clock.monotonic_ns(), Quality.BAD, error.message)
        answer = self._do_answer(reply.message)
        if isinstance(answer, float):
            return RangeReading(reply.received_ns, Quality.GOOD, None, answer, self._sigma_mm)
        return RangeReading(reply.received_ns, Quality.BAD, answer)

    def abort(self) -> None:
        """End a `read` under way soon, and all that come after. Safe from any thread."""
        self._channel.abort()

    def close(self) -> None:
        """Let the line go."""
        self._channel.close()


class DimetixRangeFinder(_AsciiRangeFinder):
    """Dimetix DLS, FLS and D-series.

    Source: Dimetix technical reference manuals, "Distance measurement (sNg)". `device_id` is the N of these.
    """

    usual_line = LineSettings(19200, 7, "E", 1)
    usual_sigma_mm = 1.0

    def __init__(
        self,
        channel: ByteChannel,
        *,
        device_id: int = 0,
        sigma_mm: float | None = None,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        super().__init__(channel, sigma_mm=sigma_mm, timeout_s=timeout_s)
        self._device_id = device_id

    @property
    def _question(self) -> bytes:
        return b"s%dg\r\n" % self._device_id

    def _do_answer(self, line: bytes) -> Answer:
        return dimetix_answer(line, self._device_id)


class AcuityRangeFinder(_AsciiRangeFinder):
    """Acuity AR1000 and its siblings (ASTECH LDM41), as they leave the factory: decimal metres, scale factor 1.

    Source: AR1000 user's manual, 5.2.1 "ASCII output format"; LDM41 manual, "DM" and "SD".
    """

    usual_line = LineSettings(9600, 8, "N", 1)
    usual_sigma_mm = 3.0

    @property
    def _question(self) -> bytes:
        return b"DM\r"

    def _do_answer(self, line: bytes) -> Answer:
        return acuity_answer(line)


def dimetix_answer(line: bytes, device_id: int) -> Answer:
    """Read ``gNg+xxxxxxxx`` (0.1 mm) or the error ``gN@Ezzz``."""
    if m := re.fullmatch(rb"g%dg([+-]\d{8})" % device_id, line):
        return _possible(int(m[1]) / 10)
    if m := re.fullmatch(rb"g%d@E(\d{3})" % device_id, line):
        return f"the range finder reports error E{m[1].decode()}"
    return None


def acuity_answer(line: bytes) -> Answer:
    """Read ``xxx.xxx`` (m), perhaps with the signal's strength behind it, or the error ``Ezz``."""
    text = line.strip(b" ")
    if m := re.fullmatch(rb"(-?\d{1,4}\.\d{3})( +\d+)?", text):
        return _possible(float(m[1]) * 1000)
    if m := re.fullmatch(rb"E(\d{2})", text):
        return f"the range finder reports error E{m[1].decode()}"
    return None


def _possible(distance_mm: float) -> float | str:
    """Nothing measures nought: it is what an offset set wrongly, or a device without a value, says."""
    return round(distance_mm, 1) if 0 < distance_mm < math.inf else f"the range finder says {distance_mm:g} mm"
