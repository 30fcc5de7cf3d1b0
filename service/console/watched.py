"""What the page needs of the service behind it: how the source does, and what may be asked of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from service.config.console import ConsoleSettings
    from service.identity.counting import NamingRule

__all__ = ["About", "RefusedError", "SourceStatus", "Watched"]


class RefusedError(Exception):
    """What was asked cannot be done now; why, in a line."""


@dataclass(frozen=True, slots=True)
class SourceStatus:
    """The source at one moment.

    Attributes
    ----------
    liveness
        In a word, what the picture is worth: LIVE, STARTING, NO SIGNAL, FROZEN, STALE, RECONNECTING or ENDED.
    reason
        In words, why it is not LIVE.
    since_ns
        Since when the picture is not new any more; None where that is not known.
    capture_fps, result_fps
        Frames arriving and frames measured, a second.
    dropped, bad
        Frames lost on the way to us or not measured for want of time, and frames that were defect or failed.
    inputs, input
        The device's video inputs and the one in use; none where it cannot switch.
    """

    liveness: str
    reason: str = ""
    since_ns: int | None = None
    capture_fps: float = 0.0
    result_fps: float = 0.0
    dropped: int = 0
    bad: int = 0
    inputs: tuple[str, ...] = ()
    input: str = ""


class Watched(Protocol):
    """The live service as the page sees it. Callable from any thread."""

    def status(self) -> SourceStatus:
        """How it does now."""
        ...

    def select_input(self, name: str) -> None:
        """Switch to another video input; raises RefusedError."""
        ...


@dataclass(frozen=True, slots=True)
class About:
    """What is being watched; it does not change while the page is served.

    Attributes
    ----------
    kind
        LIVE, REPLAY or SIMULATED.
    source, generator
        As people call them.
    rule
        How tubes are named.
    settings
        [console].
    viewer_url
        Tells where rerun's page is; None where none is served.
    """

    kind: str
    source: str
    generator: str
    rule: NamingRule
    settings: ConsoleSettings
    viewer_url: Callable[[], str | None] = field(default=lambda: None)
