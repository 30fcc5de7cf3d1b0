"""What to try next with a source that has gone wrong: pure functions of what went wrong and how often.

The rungs, gentlest first: restart the stream; close the device and open it again; look for it by its identity, where
another device node may be its own now; reset it on its bus. Each failure goes one rung up. A device that is not there
is looked for at a steady rate, which costs it nothing; one that is there and fails is left in peace for longer and
longer.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final, NamedTuple

from drivers.errors import (
    ConfigError,
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceStateError,
    DeviceTimeoutError,
    UnsupportedFormatError,
)

if TYPE_CHECKING:
    import random

    from service.config.supervision import SupervisionSettings

__all__ = ["RESET_EVERY_S", "Rung", "Step", "Trouble", "jittered", "next_step", "trouble_of"]

RESET_EVERY_S: Final = 60.0
LEAST_SHARE: Final = 0.75
"""Of a pause, that chance leaves of it: devices that failed together are not asked again together."""


class Rung(enum.IntEnum):
    """What is tried."""

    RESTART = 0
    REOPEN = 1
    SEARCH = 2
    RESET = 3

    @property
    def words(self) -> str:
        """What is done, in words."""
        return ("restarting the stream", "opening it again", "looking for it", "resetting it on its bus")[self]


class Trouble(enum.Enum):
    """What went wrong.

    STALL: it streams, and no frame comes. FAULT: it says that it failed, or speaks nonsense. GONE: it was unplugged.
    ABSENT: it is not there. REFUSED: it is there and cannot be had, or not with these settings. HUNG: a call of its
    driver did not return.
    """

    STALL = enum.auto()
    FAULT = enum.auto()
    GONE = enum.auto()
    ABSENT = enum.auto()
    REFUSED = enum.auto()
    HUNG = enum.auto()


FIRST: Final = {
    Trouble.STALL: Rung.RESTART,
    Trouble.FAULT: Rung.REOPEN,
    Trouble.HUNG: Rung.RESET,  # the call that hangs holds the device: nothing less gets it back
}
RESETTABLE: Final = {Trouble.STALL, Trouble.FAULT, Trouble.HUNG}
AT_ONCE: Final = {Trouble.STALL, Trouble.FAULT}
LOOKED_FOR: Final = {Trouble.GONE, Trouble.ABSENT}
REFUSALS: Final = (DeviceBusyError, DevicePermissionError, DeviceStateError, UnsupportedFormatError)


class Step(NamedTuple):
    """What to try, after what pause."""

    rung: Rung
    pause_s: float


def trouble_of(error: Exception) -> Trouble | None:
    """What an error means; None where trying again cannot help: settings stay as they are."""
    match error:
        case ConfigError():
            return None
        case DeviceTimeoutError():
            return Trouble.STALL
        case DeviceDisconnectedError():
            return Trouble.GONE
        case DeviceNotFoundError():
            return Trouble.ABSENT
        case _ if isinstance(error, REFUSALS):
            return Trouble.REFUSED
    return Trouble.FAULT


def next_step(
    trouble: Trouble, failures: int, settings: SupervisionSettings, *, streams: bool, may_reset: bool
) -> Step:
    """What to try next.

    Parameters
    ----------
    failures
        Attempts that failed since the source last streamed steadily, or was last found absent.
    streams
        Whether the stream is still there to be restarted.
    may_reset
        Whether the device may be reset now.
    """
    lowest = Rung.RESTART if streams else Rung.REOPEN
    highest = Rung.RESET if may_reset and trouble in RESETTABLE else Rung.SEARCH
    rung = Rung(min(max(FIRST.get(trouble, Rung.SEARCH) + failures, lowest), highest))
    return Step(rung, _pause_s(trouble, failures, settings))


def _pause_s(trouble: Trouble, failures: int, settings: SupervisionSettings) -> float:
    if failures == 0 and trouble is not Trouble.ABSENT:
        return 0.0 if trouble in AT_ONCE else settings.retry_first_s
    if trouble in LOOKED_FOR:
        return settings.look_s
    doublings = min(failures - 1, 30)
    return min(settings.retry_most_s, settings.retry_first_s * 2.0**doublings)


def jittered(pause_s: float, rng: random.Random) -> float:
    """A pause, shortened by chance."""
    return pause_s * rng.uniform(LEAST_SHARE, 1.0)
