"""The simulated device's own life: which frame it exposes when, into which buffer, and what goes wrong with it.

It has no thread: whoever asks brings the time, and it catches up.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from drivers.faults import Fault, FaultKind
from drivers.sequence import SEQUENCE_NUMBERS

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Exposure", "Record", "SimulatedDevice"]


@dataclass(slots=True, eq=False)
class Exposure:
    """A frame in one of the device's buffers.

    Attributes
    ----------
    number
        Counted from the device's first start on.
    shows
        The frame whose picture it holds: its own, unless it is frozen.
    sequence
        The device's frame number, 32 bits.
    timestamp_ns, ready_ns
        When it was exposed, and when it can be read.
    channel
        The input it was taken from.
    kinds
        What is wrong with it.
    readings
        How often it is still to be handed over.
    fresh
        Whether it was not handed over yet.
    """

    number: int
    shows: int
    sequence: int
    timestamp_ns: int
    ready_ns: int
    channel: int
    kinds: frozenset[FaultKind]
    readings: int
    fresh: bool = True


@dataclass(slots=True)
class Record:
    """What the device did, counted exactly.

    `exposed = delivered - repeated + dropped + overrun + discarded`, and those still in its buffers.

    Attributes
    ----------
    exposed
        Frames it numbered.
    delivered
        Readings of a frame; both fields of one are one reading.
    repeated
        Readings of a frame that had been handed over before.
    dropped
        Frames lost by a fault.
    overrun
        Frames lost because no buffer was free: nobody read in time.
    discarded
        Frames that were waiting when it was stopped or unplugged.
    struck
        Faults that happened, by kind.
    """

    exposed: int = 0
    delivered: int = 0
    repeated: int = 0
    dropped: int = 0
    overrun: int = 0
    discarded: int = 0
    struck: Counter[FaultKind] = field(default_factory=Counter)


class SimulatedDevice:
    """A camera with a few buffers and a script of faults.

    Parameters
    ----------
    faults
        What goes wrong, and when.
    buffers
        Frames it holds for a late reader; further ones are lost, the oldest are kept.
    """

    def __init__(self, faults: Sequence[Fault], *, buffers: int) -> None:
        self.record = Record()
        self.channel = 0
        self.gone_until_ns: float | None = None
        self._buffers = buffers
        self._script: dict[int, list[Fault]] = {}
        for fault in faults:
            self._script.setdefault(fault.at, []).append(fault)
        self._wraps = sorted(f.at for f in faults if f.kind is FaultKind.SEQUENCE_WRAP)
        self._lasting: list[Fault] = []
        self._waiting: deque[Exposure] = deque()
        self._number, self._sequence = 0, 0
        self._owed = 0.0
        self._next_ns: float = 0  # whole, or infinity
        self._stamp_ns = 0
        """When the next frame is exposed, and the time it is stamped with; they differ in free running only."""
        self._period_ns, self._paced = 1, True

    def start(self, now_ns: int, period_ns: int, owed: float, *, paced: bool) -> None:
        """Begin to expose a frame every `period_ns`, `owed` in all; unpaced: whenever the buffers are empty."""
        self._period_ns, self._owed, self._paced = period_ns, owed, paced
        self._stamp_ns = now_ns + period_ns
        self._next_ns = self._stamp_ns if paced else now_ns
        to_wrap = next((at - self._number for at in self._wraps if at > self._number), 0)
        self._sequence = -to_wrap % SEQUENCE_NUMBERS

    def stop(self) -> None:
        """Stop exposing and forget what is waiting."""
        self._owed = 0
        self.record.discarded += sum(e.fresh for e in self._waiting)
        self._waiting.clear()

    def trigger(self, now_ns: int) -> None:
        """Expose one frame more, a period from now at the earliest."""
        if self._owed < 1:
            self._next_ns = max(self._next_ns, now_ns + (self._period_ns if self._paced else 0))
            self._stamp_ns = max(self._stamp_ns, now_ns + self._period_ns)
        self._owed += 1

    def take(self, now_ns: int) -> Exposure | None:
        """Catch up with the time, and give the oldest frame that is ready."""
        while self._owed >= 1 and self.gone_until_ns is None and self._next_ns <= now_ns:
            if not self._paced and self._waiting:
                break
            self._expose(now_ns)
        if not self._waiting or self._waiting[0].ready_ns > now_ns:
            return None
        exposure = self._waiting[0]
        self.record.delivered += 1
        self.record.repeated += not exposure.fresh
        exposure.fresh = False
        exposure.readings -= 1
        if exposure.readings == 0:
            self._waiting.popleft()
        return exposure

    def wakes_ns(self) -> float:
        """When `take` may have something new to say; infinity for never."""
        ready_ns = self._waiting[0].ready_ns if self._waiting else math.inf
        exposes = self._owed >= 1 and (self._paced or not self._waiting)
        return min(ready_ns, self._next_ns) if exposes else ready_ns

    def _expose(self, now_ns: int) -> None:
        begun = self._script.pop(self._number, [])
        for kind in (FaultKind.DISCONNECT, FaultKind.HANG):
            if halt := next((f for f in begun if f.kind is kind), None):
                begun.remove(halt)
                self._script[self._number] = begun  # they strike when the frame comes after all
                self._halt(halt)
                return
        self.record.struck.update(f.kind for f in begun)
        self._lasting = [f for f in self._lasting if self._number < f.at + f.frames] + begun
        self._buffer(now_ns)
        self._number += 1
        self._sequence = (self._sequence + 1) % SEQUENCE_NUMBERS
        self._owed -= 1
        self._stamp_ns += self._period_ns
        if self._paced:
            self._next_ns = self._stamp_ns

    def _halt(self, fault: Fault) -> None:
        self.record.struck[fault.kind] += 1
        pause_ns = math.inf if math.isinf(fault.seconds) else round(fault.seconds * 1e9)
        if fault.kind is FaultKind.DISCONNECT:
            self.gone_until_ns = self._next_ns + pause_ns
            self.stop()
            return
        self._next_ns += pause_ns
        if self._paced and not math.isinf(pause_ns):
            self._stamp_ns += int(pause_ns)

    def _buffer(self, now_ns: int) -> None:
        faults = {f.kind: f for f in self._lasting}
        self.record.exposed += 1
        if FaultKind.DROP in faults:
            self.record.dropped += 1
            return
        if len(self._waiting) >= self._buffers:
            self.record.overrun += 1
            return
        delay, repeat, freeze = (faults.get(k) for k in (FaultKind.DELAY, FaultKind.REPEAT, FaultKind.FREEZE))
        ready_ns = (self._stamp_ns if self._paced else now_ns) + round(1e9 * delay.seconds if delay else 0)
        self._waiting.append(
            Exposure(
                number=self._number,
                shows=max(0, freeze.at - 1) if freeze else self._number,
                sequence=self._sequence,
                timestamp_ns=self._stamp_ns,
                ready_ns=max(ready_ns, self._waiting[-1].ready_ns if self._waiting else 0),
                channel=self.channel,
                kinds=frozenset(faults),
                readings=1 + (repeat.frames if repeat and repeat.at == self._number else 0),
            )
        )
