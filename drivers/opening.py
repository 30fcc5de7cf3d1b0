"""From a source's name to its grabber."""

from __future__ import annotations

import difflib
import functools
import logging
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl

import numpy as np

from drivers.encodings import ENCODINGS
from drivers.errors import ConfigError, DeviceNotFoundError
from drivers.grabber import Clock, FieldMode, Grabber
from drivers.identity import SYSFS
from drivers.opencv import OpenCvGrabber
from drivers.replay import ReplayGrabber
from drivers.scene import GENERATORS, LOOKS
from drivers.simulated import SimulatedGrabber
from drivers.simulation import default_scene
from drivers.uvc.grabber import UvcGrabber
from drivers.uvc.link import reset_usb_device
from drivers.v4l2.grabber import V4l2Grabber

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

__all__ = ["bus_reset", "open_grabber"]

log = logging.getLogger(__name__)

SOURCES = (
    "a video, a folder of pictures, a picture, v4l2:DEVICE[?key=value&...], uvc:DEVICE[?key=value&...],"
    " opencv:DEVICE[?key=value&...] or simulated[:GENERATOR][?key=value&...];"
    " bowlsight devices lists what is there"
)
NODE = re.compile(r"/dev/video\d+")
USUAL_GENERATOR = "system80"


def open_grabber(
    source: str,
    *,
    speed: float = 1.0,
    loop: bool = False,
    rate_hz: float = 25.0,
    field_mode: FieldMode = FieldMode.FRAME,
    top_first: bool = True,
    clock: Clock | None = None,
) -> Grabber:
    """Give the grabber for a source, closed: its `open`, or a `with` block, takes the device.

    Parameters
    ----------
    source
        Path of a video, a folder of pictures or a picture; or a capture device by its identity, or by its node,
        ``v4l2:usb-534d:2109-A1``, with any of ``?size=640x480&encoding=YUYV&rate_hz=25&fields=alternate&buffers=8``
        ``&newest=no``; as ``uvc:`` read over USB without the kernel's driver, or as ``opencv:`` through OpenCV, whose
        own number will do too, both without buffers and newest; or ``simulated``, or ``simulated:delta60`` for another
        steam generator, with any of
        ``?seed=0&size=640x480&rate_hz=25&bits=8&interlaced=no&look=nominal&loop_frames=48&pitch_px=40``.
    speed
        1.0 is the source's own pace; infinity is as fast as it is read. A device has its own.
    loop, rate_hz, top_first
        For recordings, see `ReplayGrabber`.
    field_mode
        Woven frames, or fields.
    clock
        Where `received_ns` and waiting come from.

    Raises
    ------
    DeviceNotFoundError
        There is no such kind of source.
    ConfigError
        A value in the source's name is unknown or impossible.
    """
    kind, _, query = source.partition("?")
    if NODE.fullmatch(kind):
        return _device(source, "v4l2", kind, query, field_mode=field_mode, clock=clock)
    scheme, _, device = kind.partition(":")
    if scheme in _DEVICES:
        return _device(source, scheme, device, query, field_mode=field_mode, clock=clock)
    if kind == "simulated" or kind.startswith("simulated:"):
        generator = kind.partition(":")[2] or USUAL_GENERATOR
        return _simulated(source, generator, query, speed=speed, field_mode=field_mode, clock=clock)
    if (unknown := re.match(r"[a-z][a-z0-9+.-]+:", source)) and not Path(source).exists():
        raise DeviceNotFoundError(source, f"{unknown[0]} is no kind of source; give {SOURCES}")
    return ReplayGrabber(
        source, speed=speed, loop=loop, rate_hz=rate_hz, field_mode=field_mode, top_first=top_first, clock=clock
    )


def bus_reset(source: str, sysfs: Path = SYSFS) -> Callable[[], None] | None:
    """Give what resets a source's device on its bus; None for what is no USB device known by its identity.

    Whoever has it open loses it, as in a replug. What is given raises DeviceError where the device is not there, may
    not be opened, or does not even answer to that.
    """
    scheme, _, device = source.partition("?")[0].partition(":")
    if scheme not in _DEVICES or not (device.startswith("usb-") or "-usb-" in device):
        return None
    return functools.partial(reset_usb_device, device, source, sysfs)


def _simulated(
    source: str, generator: str, query: str, *, speed: float, field_mode: FieldMode, clock: Clock | None
) -> SimulatedGrabber:
    lattice = _known(source, "steam generator", generator, GENERATORS)
    values = _values(source, query, _SIMULATED)
    loop_frames: int = values.pop("loop_frames", 48)
    values["look"] = _known(source, "look", values.get("look", "nominal"), LOOKS)
    rng = np.random.default_rng(values.pop("seed", 0))
    scene = default_scene(lattice, rng, frames=max(1, loop_frames - 1), **values)
    return SimulatedGrabber(
        scene, loop_frames=loop_frames, speed=speed, field_mode=field_mode, name=source, rng=rng, clock=clock
    )


def _device(
    source: str, scheme: str, device: str, query: str, *, field_mode: FieldMode, clock: Clock | None
) -> Grabber:
    make, names, keys = _DEVICES[scheme]
    if not re.fullmatch(names, device):
        raise ConfigError(f"{source}: no device has such a name; bowlsight devices lists those that are there")
    if NODE.fullmatch(device):
        log.warning("%s may be another device after a replug; bowlsight devices tells its lasting name", device)
    values = {"field_mode": field_mode} | _values(source, query, {key: _DEVICE[key] for key in keys})
    return make(device, name=source, clock=clock, **values)


def _values(source: str, query: str, keys: Mapping[str, tuple[str, Callable[[str], Any]]]) -> dict[str, Any]:
    """Arguments by their names, converted."""
    values = {}
    for key, text in parse_qsl(query, keep_blank_values=True):
        argument, convert = _known(source, "key", key, keys)
        try:
            values[argument] = convert(text)
        except ValueError as error:
            raise ConfigError(f"{source}: {key} = {text!r}: {error}") from error
    return values


def _known(source: str, what: str, name: str, known: Mapping[str, Any]) -> Any:
    if name in known:
        return known[name]
    near = difflib.get_close_matches(name, known, 1, 0.4)
    hint = f"did you mean {near[0]}? " if near else ""
    raise ConfigError(f"{source}: unknown {what} {name!r}; {hint}known: {', '.join(known)}")


def _whole(low: int, high: int) -> Callable[[str], int]:
    def convert(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise ValueError(f"must be a whole number from {low} to {high}")
        return int(text)

    return convert


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise ValueError("must be a number above 0")
    return value


def _size(text: str) -> tuple[int, int]:
    size = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if size is None:
        raise ValueError("must be like 640x480, 10 to 9999 px a side")
    return int(size[1]), int(size[2])


def _yes_or_no(text: str) -> bool:
    if text not in ("yes", "no"):
        raise ValueError("must be yes or no")
    return text == "yes"


def _bits(text: str) -> int:
    if text not in ("8", "16"):
        raise ValueError("must be 8 or 16")
    return int(text)


def _one_of(known: Collection[str]) -> Callable[[str], str]:
    def convert(text: str) -> str:
        if text not in known:
            raise ValueError(f"must be one of {', '.join(known)}")
        return text

    return convert


_SIMULATED: dict[str, tuple[str, Callable[[str], Any]]] = {
    "seed": ("seed", _whole(0, 2**62)),
    "size": ("size_px", _size),
    "rate_hz": ("rate_hz", _positive),
    "bits": ("bits", _bits),
    "interlaced": ("interlaced", _yes_or_no),
    "look": ("look", str),
    "loop_frames": ("loop_frames", _whole(1, 5000)),
    "pitch_px": ("pitch_px", _positive),
}
"""Keys of a simulated source: the arguments of `default_scene`, and `seed` and `loop_frames`."""
_DEVICE: dict[str, tuple[str, Callable[[str], Any]]] = {
    "size": ("size_px", _size),
    "encoding": ("encoding", _one_of(ENCODINGS)),
    "rate_hz": ("rate_hz", _positive),
    "fields": ("field_mode", lambda text: FieldMode(_one_of(list(map(str, FieldMode)))(text))),
    "buffers": ("buffers", _whole(2, 32)),
    "newest": ("newest", _yes_or_no),
}
"""Keys of a capture device: the arguments of its grabber."""
_ALWAYS = ("size", "encoding", "rate_hz", "fields")
_DEVICES: dict[str, tuple[Callable[..., Grabber], str, tuple[str, ...]]] = {
    "v4l2": (V4l2Grabber, r"(usb|path)-.+|/.+", (*_ALWAYS, "buffers", "newest")),
    "uvc": (UvcGrabber, r"(usb|path)-.+", _ALWAYS),
    "opencv": (OpenCvGrabber, r"(usb|path)-.+|/.+|\d{1,3}", _ALWAYS),
}
"""Ways to a capture device: grabber, names that it takes, keys."""
