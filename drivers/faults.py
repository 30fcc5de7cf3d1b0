"""What a simulated device is told to do wrong, and when."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

__all__ = ["Fault", "FaultKind", "random_faults"]


class FaultKind(enum.StrEnum):
    """What goes wrong at a frame."""

    DROP = "drop"
    """It is numbered but never handed over."""
    REPEAT = "repeat"
    """It is handed over again, number and all, as often as `frames` says."""
    DELAY = "delay"
    """It is ready only `seconds` later; what follows queues behind it."""
    TRUNCATE = "truncate"
    """Its lower half never came; the device says so."""
    FREEZE = "freeze"
    """The picture before it is sent again under its number; the device does not notice."""
    BLACK = "black"
    """It is black; the device does not notice."""
    NOISE = "noise"
    """It is noise; the device does not notice."""
    ERROR_FLAG = "error-flag"
    """The device marks it as bad."""
    WRONG_SIZE = "wrong-size"
    """It comes half as wide and high; the driver notices."""
    HANG = "hang"
    """The device stands still for `seconds`, or until it is stopped, and then goes on with this frame."""
    DISCONNECT = "disconnect"
    """The device is gone before this frame; `open` finds it again after `seconds`."""
    SEQUENCE_WRAP = "sequence-wrap"
    """The device's 32-bit frame number starts again from 0 at this frame."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes
    ----------
    kind
        What goes wrong.
    at
        Number of the frame, counted from the device's first start on and over restarts and reconnections.
    frames
        How many frames in a row it lasts, or how often a frame repeats.
    seconds
        How long it lasts, where that is what counts.
    """

    kind: FaultKind
    at: int
    frames: int = 1
    seconds: float = 0.0

    def __post_init__(self) -> None:
        if self.at < 0 or self.frames < 1 or not self.seconds >= 0:
            raise ValueError(f"{self}: at must be 0 or more, frames 1 or more, seconds 0 or more")


def random_faults(
    rng: np.random.Generator, frames: int, share: float, *, kinds: Sequence[FaultKind] = tuple(FaultKind),
    most_frames: int = 5, most_seconds: float = 0.2,
) -> tuple[Fault, ...]:  # fmt: skip
    """Draw a script for the first `frames` frames, in which on average `share` of them begin a fault."""
    at = rng.random(frames).__lt__(share).nonzero()[0]
    return tuple(
        Fault(
            kinds[int(rng.integers(len(kinds)))],
            int(number),
            int(rng.integers(1, most_frames + 1)),
            float(rng.uniform(0, most_seconds)),
        )
        for number in at
    )
