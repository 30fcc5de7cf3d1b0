"""The station file's [supervision] and [health]: when a source counts as gone wrong, and how the service is watched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.config.table import Table

__all__ = ["HealthSettings", "SupervisionSettings", "read_health", "read_supervision"]


@dataclass(frozen=True, slots=True)
class SupervisionSettings:
    """[supervision].

    Attributes
    ----------
    stall_s, stall_frames
        A stream without a frame for longer, whichever is more, stands still.
    first_frame_s
        How long a device may take from its start to its first frame.
    hung_s
        A call of the driver that takes so much longer than it was given is left behind.
    late_s
        Frames that are older when they arrive are not live.
    frozen_frames
        So many frames in a row that are the same byte for byte, or flat, say that the picture is not that of a camera.
    flat_levels
        A picture whose grey values lie within so many levels is flat.
    frozen_restart_s
        A picture that is frozen for longer has its source restarted.
    retry_first_s, retry_most_s
        Pause before the second attempt at a device that is there and fails; it doubles up to the last.
    look_s
        How often a device that is not there is looked for.
    usb_reset
        Whether a device that nothing else helps may be reset on its bus, at most once a minute.
    """

    stall_s: float = 0.5
    stall_frames: float = 5.0
    first_frame_s: float = 3.0
    hung_s: float = 3.0
    late_s: float = 0.5
    frozen_frames: int = 3
    flat_levels: int = 4
    frozen_restart_s: float = 10.0
    retry_first_s: float = 0.25
    retry_most_s: float = 5.0
    look_s: float = 0.5
    usb_reset: bool = False


@dataclass(frozen=True, slots=True)
class HealthSettings:
    """[health].

    Attributes
    ----------
    metrics_port
        Where Prometheus may ask, on loopback; None: nowhere.
    log_every_s
        How often a line of the log says how the service does.
    """

    metrics_port: int | None = None
    log_every_s: float = 60.0


def read_health(t: Table) -> HealthSettings:
    """Read [health]."""
    default = HealthSettings()
    settings = HealthSettings(
        metrics_port=t.integer("metrics_port", default.metrics_port, minimum=1, maximum=65535),
        log_every_s=t.number("log_every_s", default.log_every_s, minimum=1, maximum=86400),
    )
    t.finish()
    return settings


def read_supervision(t: Table) -> SupervisionSettings:
    """Read [supervision]."""
    default = SupervisionSettings()
    settings = SupervisionSettings(
        stall_s=t.number("stall_s", default.stall_s, minimum=0.1, maximum=60),
        stall_frames=t.number("stall_frames", default.stall_frames, minimum=2, maximum=100),
        first_frame_s=t.number("first_frame_s", default.first_frame_s, minimum=0.5, maximum=60),
        hung_s=t.number("hung_s", default.hung_s, minimum=0.5, maximum=60),
        late_s=t.number("late_s", default.late_s, minimum=0.05, maximum=60),
        frozen_frames=t.integer("frozen_frames", default.frozen_frames, minimum=2, maximum=1000),
        flat_levels=t.integer("flat_levels", default.flat_levels, minimum=0, maximum=255),
        frozen_restart_s=t.number("frozen_restart_s", default.frozen_restart_s, minimum=1, maximum=3600),
        retry_first_s=t.number("retry_first_s", default.retry_first_s, minimum=0.05, maximum=60),
        retry_most_s=t.number("retry_most_s", default.retry_most_s, minimum=0.05, maximum=600),
        look_s=t.number("look_s", default.look_s, minimum=0.1, maximum=60),
        usb_reset=t.flag("usb_reset", default.usb_reset),
    )
    t.finish()
    if settings.retry_most_s < settings.retry_first_s:
        raise t.error("retry_most_s", f"must be at least retry_first_s = {settings.retry_first_s:g}")
    return settings
