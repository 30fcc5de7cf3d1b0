"""What a video device is and offers, for people; however it is read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.access import Holder
    from drivers.grabber import SignalStatus, Standard

__all__ = ["OfferedFormat", "OfferedInput", "VideoDevice"]


@dataclass(frozen=True, slots=True)
class OfferedInput:
    """An input; `signal` is known of the one in use only."""

    name: str
    kind: str
    standards: tuple[Standard, ...]
    in_use: bool
    signal: SignalStatus


@dataclass(frozen=True, slots=True)
class OfferedFormat:
    """An encoding that can be grabbed, and its sizes in px; the least and the greatest where all between will do."""

    encoding: str
    sizes_px: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class VideoDevice:
    """A video device that captures, or that may not be asked whether it does.

    Attributes
    ----------
    node
        Where it is now.
    name, driver
        What it calls itself, and the kernel's driver.
    identity
        What it is known by, also after a replug.
    inputs, formats
        What it offers.
    held_by
        Processes that have it open.
    problem
        Why it cannot be opened, and what to do; None where it can.
    scheme
        How it is read: "v4l2" through the kernel's driver, "uvc" over USB without one.
    """

    node: str
    name: str
    identity: str
    driver: str = ""
    inputs: tuple[OfferedInput, ...] = ()
    formats: tuple[OfferedFormat, ...] = ()
    held_by: tuple[Holder, ...] = field(default=())
    problem: str | None = None
    scheme: str = "v4l2"

    @property
    def source(self) -> str:
        """How `open_grabber` takes it."""
        return f"{self.scheme}:{self.identity}"
