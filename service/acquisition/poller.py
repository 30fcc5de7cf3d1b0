"""A thread that asks one instrument at a steady rate, and what it said last."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from drivers.reading import Quality
from service.acquisition.repeated import RepeatedLog

if TYPE_CHECKING:
    from drivers.grabber import Clock

__all__ = ["Heard", "Instrument", "InstrumentPoller", "Reading"]

log = logging.getLogger(__name__)


class Reading(Protocol):
    """What all instruments' readings have."""

    @property
    def time_ns(self) -> int:
        """When it was in hand, monotonic."""
        ...

    @property
    def quality(self) -> Quality:
        """GOOD or BAD."""
        ...

    @property
    def reason(self) -> str | None:
        """In words, why it is not GOOD."""
        ...


R = TypeVar("R", bound=Reading)
R_co = TypeVar("R_co", bound=Reading, covariant=True)


@dataclass(frozen=True, slots=True)
class Heard(Generic[R]):
    """The last reading, good or bad; the last good one; the good one before that. None where there is none yet."""

    newest: R | None = None
    good: R | None = None
    good_before: R | None = None


class Instrument(Protocol[R_co]):
    """A lens, a range finder: `read` blocks for a bounded time, `abort` may be called from any thread."""

    @property
    def name(self) -> str:
        """How the log and people call it."""
        ...

    def read(self) -> R_co:
        """Ask it."""
        ...

    def abort(self) -> None:
        """End a `read` under way soon, and all that come after."""
        ...

    def close(self) -> None:
        """Let the device go."""
        ...


class InstrumentPoller(Generic[R]):
    """Reads an instrument until stopped, and keeps its last good reading, the one before that, and the last of any.

    Parameters
    ----------
    instrument
        From `start` on only this thread touches it, but for `abort`; it is closed at the end.
    kind
        What the thread and the log call it, such as "lens".
    rate_hz
        How often to read. A reading that takes longer than that puts off the next; none is made up for.
    clock
        For the age of readings and the rate.
    """

    def __init__(self, instrument: Instrument[R], kind: str, rate_hz: float, clock: Clock) -> None:
        self._instrument, self._clock = instrument, clock
        self._period_ns = round(1e9 / rate_hz)
        self._log = RepeatedLog(log, clock)
        self.name = f"the {kind} at {instrument.name}"
        self._stop = threading.Event()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"bowlsight-{kind}", daemon=True)
        self.heard: Heard[R] = Heard()
        """What it said so far; replaced whole, so that any thread may look at it."""
        self.polls = self.failures = 0
        """Readings so far, and how many of them were none."""

    def start(self) -> None:
        """Begin to read. Returns at once: a device that is not there is looked for as long as this runs."""
        self._thread.start()

    def request_stop(self) -> None:
        """Ask it to end; returns at once."""
        self._stop.set()
        self._instrument.abort()

    def join(self, timeout_s: float) -> bool:
        """Wait for its end; False where it is stuck in its device."""
        return self._thread.ident is None or self._done.wait(max(0.0, timeout_s))

    def _run(self) -> None:
        try:
            due_ns = self._clock.monotonic_ns()
            while not self._stop.is_set():
                self._read_once()
                now_ns = self._clock.monotonic_ns()
                due_ns = max(due_ns + self._period_ns, now_ns)
                self._stop.wait((due_ns - now_ns) / 1e9)
        finally:
            self._let_go()

    def _read_once(self) -> None:
        try:
            reading = self._instrument.read()
        except Exception as error:  # noqa: BLE001 - a driver's mistake costs its reading, not the watch
            self.polls, self.failures = self.polls + 1, self.failures + 1
            self._log.warning("mistake", f"{self.name}: {type(error).__name__}: {error}", error)
            return
        if self._stop.is_set():
            return
        before = self.heard
        good = (reading, before.good) if reading.quality is Quality.GOOD else (before.good, before.good_before)
        self.heard = Heard(reading, *good)
        self.polls, self.failures = self.polls + 1, self.failures + (reading.quality is not Quality.GOOD)
        self._tell(before.newest, reading)

    def _tell(self, before: R | None, reading: R) -> None:
        if reading.quality is not Quality.GOOD:
            self._log.warning("bad", f"{self.name}: {reading.reason}")
        elif before is not None and before.quality is not Quality.GOOD:
            log.info("%s: answers again", self.name)

    def _let_go(self) -> None:
        try:
            self._instrument.close()
        except Exception:
            log.exception("%s: closing failed", self.name)
        self._done.set()
