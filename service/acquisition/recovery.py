"""What has been tried with a source that went wrong, and what comes next."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from service.acquisition.ladder import RESET_EVERY_S, Step, Trouble, jittered, next_step, trouble_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.grabber import Clock, Grabber
    from service.config.supervision import SupervisionSettings

__all__ = ["Recovery", "Supervision"]

STEADY_S: Final = 2.0
"""A stream that gives good frames for so long has recovered: its next failure is a first one."""


@dataclass(frozen=True, slots=True)
class Supervision:
    """How a live source is watched and got back.

    Attributes
    ----------
    remake
        Makes another grabber of the same source, for when a call of this one's never returns. None: that is final.
    reset
        Resets the device on its bus; may raise DeviceError. None: not allowed, or it has none.
    rng
        Shortens pauses.
    """

    settings: SupervisionSettings
    remake: Callable[[], Grabber] | None = None
    reset: Callable[[], None] | None = None
    rng: random.Random | None = None


class Recovery:
    """Counts failures and chooses steps. Used by the thread that owns the source, one at a time."""

    def __init__(self, supervision: Supervision, clock: Clock) -> None:
        self._supervision, self._clock = supervision, clock
        self._rng = supervision.rng or random.Random()  # noqa: S311 - spreads pauses, keeps no secret
        self.failures = 0
        """Attempts that failed since it last streamed steadily, or was last found absent."""
        self._stream_ns = self._since_ns = self._reset_ns = -math.inf
        self.trouble = ""
        """In words, what it recovers from; empty while nothing is wrong."""
        self.recoveries = 0

    def begin_stream(self) -> None:
        """Take note that the source was started."""
        self._stream_ns = self._clock.monotonic_ns()

    def frame(self, *, bad: bool) -> str | None:
        """Take note of a frame; in words, how it was got back, where it is the first one after a failure."""
        now_ns = self._clock.monotonic_ns()
        if not bad and now_ns - self._stream_ns > STEADY_S * 1e9:
            self.failures = 0
        if not self.trouble:
            return None
        self.trouble = ""
        self.recoveries += 1
        return f"streams again, {(now_ns - self._since_ns) / 1e9:.1f} s after it failed"

    def after(self, error: Exception, *, streams: bool) -> Step | None:
        """What to try after an error; None where trying again cannot help."""
        trouble = trouble_of(error)
        return None if trouble is None else self._step(trouble, str(error), streams=streams)

    def after_hang(self, words: str) -> Step:
        """What to try after a call of the driver that did not return; by another thread, with another grabber."""
        return self._step(Trouble.HUNG, words, streams=False)

    def _step(self, trouble: Trouble, words: str, *, streams: bool) -> Step:
        now_ns = self._clock.monotonic_ns()
        if not self.trouble:
            self._since_ns = now_ns
        self.trouble = words
        may_reset = self._supervision.reset is not None and now_ns - self._reset_ns >= RESET_EVERY_S * 1e9
        step = next_step(trouble, self.failures, self._supervision.settings, streams=streams, may_reset=may_reset)
        self.failures = 0 if trouble is Trouble.ABSENT else self.failures + 1
        return Step(step.rung, jittered(step.pause_s, self._rng))

    def reset(self) -> None:
        """Reset the device on its bus; raises DeviceError."""
        assert self._supervision.reset is not None, "chosen only where it is allowed"
        self._reset_ns = self._clock.monotonic_ns()
        self._supervision.reset()

    @property
    def settings(self) -> SupervisionSettings:
        """When the source counts as gone wrong."""
        return self._supervision.settings
