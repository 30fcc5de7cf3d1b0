"""A grabber as its thread uses it: every call noted while it lasts, its input kept over a replug."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from drivers.grabber import GrabberState
from service.acquisition.watchdog import Call

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from drivers.frame import Frame
    from drivers.grabber import FrameFormat, Grabber, SignalStatus

__all__ = ["Device"]

OPEN_S, START_S, CLOSE_S, ASK_S, RESET_S = 5.0, 3.0, 2.0, 1.0, 5.0
"""What calls of a driver may take; see `watchdog.is_hung`."""


class Device:
    """Calls a grabber, for one thread; others may look at what it says of itself.

    Parameters
    ----------
    grabber
        Closed.
    prepare
        Called whenever it is open and does not stream: sets input, standard and controls.
    like
        The one before, whose input it is to have; None: as `prepare` and the device say.
    """

    def __init__(
        self, grabber: Grabber, prepare: Callable[[Grabber], None] | None = None, like: Device | None = None
    ) -> None:
        self._grabber, self._prepare = grabber, prepare
        self.name, self.clock = grabber.name, grabber.clock
        self.call: Call | None = None
        """The call under way."""
        self.format: FrameFormat | None = None if like is None else like.format
        self.input: str | None = None if like is None else like.input
        """Of the last time it was open."""
        self.inputs: tuple[str, ...] = () if like is None else like.inputs

    @contextlib.contextmanager
    def _calling(self, doing: str, allowed_s: float) -> Iterator[None]:
        """Note what it is called for: a watchdog sees to it that this ends."""
        self.call = Call(doing, self.clock.monotonic_ns(), allowed_s)
        try:
            yield
        finally:
            self.call = None

    @property
    def generation(self) -> int:
        """How often it was opened."""
        return self._grabber.generation

    @property
    def streams(self) -> bool:
        """Whether it is still there to be read, as far as it says."""
        return self._grabber.state is GrabberState.STREAMING

    def open(self) -> FrameFormat:
        """Open it and set it up."""
        grabber = self._grabber
        with self._calling("opening", OPEN_S):
            grabber.open()
            if self._prepare is not None:
                self._prepare(grabber)
            self.inputs = tuple(i.name for i in grabber.inputs)
            if self.input in self.inputs and grabber.input != self.input:
                grabber.select_input(self.input)
            self.input = grabber.input
            self.format = grabber.format
        return self.format

    def start(self) -> None:
        """Begin to stream."""
        with self._calling("starting", START_S):
            self._grabber.start()

    def read(self, timeout_s: float) -> Frame | None:
        """Wait for a frame; None where none came in time."""
        try:
            with self._calling("reading", timeout_s):
                return self._grabber.read(timeout_s)
        except TimeoutError:
            return None

    def stop(self) -> None:
        """End streaming."""
        with self._calling("stopping", CLOSE_S):
            self._grabber.stop()

    def close(self) -> None:
        """Give it back."""
        with self._calling("closing", CLOSE_S):
            self._grabber.close()

    def reset(self, on_its_bus: Callable[[], None]) -> None:
        """Reset it, closed."""
        with self._calling("resetting", RESET_S):
            on_its_bus()

    def look(self) -> tuple[SignalStatus, str]:
        """What it says of its signal, and which input it is switched to."""
        with self._calling("asking for its signal", ASK_S):
            return self._grabber.signal_status(), self._grabber.input

    def select_input(self, name: str) -> None:
        """Switch to an input, also while streaming."""
        with self._calling(f"switching to input {name}", ASK_S):
            self._grabber.select_input(name)
        self.input = name
