"""The station file: what `bowlsight run` grabs, measures with, and shows."""

from __future__ import annotations

import enum
import ipaddress
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from drivers.automatics import AUTOMATICS
from drivers.errors import ConfigError
from drivers.frame import Field
from drivers.grabber import Standard
from service.config.alignment import GuideSettings, IdentitySettings, read_alignment, read_identity
from service.config.cameras import read_camera
from service.config.console import ConsoleSettings, read_console
from service.config.generators import SteamGenerator, load_generator
from service.config.instruments import LensSettings, RangeFinderSettings, lens_settings, range_finder_settings
from service.config.recording import RecordingSettings, recording_settings
from service.config.supervision import HealthSettings, SupervisionSettings, read_health, read_supervision
from service.config.table import Table, read_toml

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from service.vision.camera import Camera

__all__ = ["FieldOrder", "MeasuringSettings", "SourceSettings", "Station", "ViewerSettings", "read_station"]


DEVICE_KIND = re.compile(r"simulated($|[:?])|[a-z][a-z0-9+.-]+:")
"""How the name of a device begins that is no path: as `open_grabber` takes it."""


class FieldOrder(enum.StrEnum):
    """How to take interlaced pictures: decide from the picture, as whole ones, or as fields with that one first."""

    AUTO = "auto"
    PROGRESSIVE = "progressive"
    TOP = "top"
    BOTTOM = "bottom"

    @property
    def field(self) -> Field | None:
        """What every frame is taken for; None: as its source says."""
        return {
            FieldOrder.AUTO: None,
            FieldOrder.PROGRESSIVE: Field.PROGRESSIVE,
            FieldOrder.TOP: Field.INTERLACED_TOP_FIRST,
            FieldOrder.BOTTOM: Field.INTERLACED_BOTTOM_FIRST,
        }[self]


@dataclass(frozen=True, slots=True)
class SourceSettings:
    """[source]: `device` as `open_grabber` takes it; what is None, NONE or not listed stays as the device has it."""

    device: str
    input: str | None = None
    standard: Standard = Standard.NONE
    lock: tuple[str, ...] = ()
    controls: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class MeasuringSettings:
    """[measuring]."""

    field_order: FieldOrder = FieldOrder.AUTO
    oldest_frame_ms: float = 1000.0


@dataclass(frozen=True, slots=True)
class ViewerSettings:
    """[viewer]: a port that is None is rerun's usual one, or the next that is free."""

    enabled: bool = True
    address: str = "127.0.0.1"
    port: int | None = None
    web_port: int | None = None
    open_browser: bool = False
    memory_mib: int = 256


@dataclass(frozen=True, slots=True)
class Station:
    """A station file, with the generator, the camera and the guide that it names; no guide, no alignment."""

    source: SourceSettings
    generator: SteamGenerator
    camera: Camera | None
    measuring: MeasuringSettings
    viewer: ViewerSettings
    lens: LensSettings | None = None
    range_finder: RangeFinderSettings | None = None
    identity: IdentitySettings = field(default_factory=IdentitySettings)
    alignment: GuideSettings | None = None
    supervision: SupervisionSettings = field(default_factory=SupervisionSettings)
    health: HealthSettings = field(default_factory=HealthSettings)
    console: ConsoleSettings = field(default_factory=ConsoleSettings)
    recording: RecordingSettings = field(default_factory=RecordingSettings)


def read_station(path: Path) -> Station:
    """Read a station file and what it names; raises ConfigError where a key is missing, unknown or impossible."""
    t = read_toml(path)
    source, generator, camera = t.table("source", required=True), t.table("generator", required=True), t.table("camera")
    measuring, viewer = t.table("measuring"), t.table("viewer")
    lens, range_finder = t.table("lens"), t.table("range_finder")
    supervision, health, recording = t.table("supervision"), t.table("health"), t.table("recording")
    identity, alignment, console = t.table("identity"), t.table("alignment"), t.table("console")
    t.finish()
    tubes, names = _generator(generator, path.parent), read_identity(identity, path.parent)
    return Station(
        source=_source(source, path.parent),
        generator=tubes,
        camera=_camera(camera, path.parent),
        measuring=_measuring(measuring),
        viewer=_viewer(viewer),
        lens=lens_settings(lens),
        range_finder=range_finder_settings(range_finder),
        identity=names,
        alignment=read_alignment(alignment, path.parent, tubes, names.rule(tubes)),
        supervision=read_supervision(supervision),
        health=read_health(health),
        console=read_console(console),
        recording=recording_settings(recording, path.parent),
    )


def _source(t: Table, folder: Path) -> SourceSettings:
    device = t.text("device")
    if not device.strip():
        raise t.error("device", 'must name a source: "simulated", a video, or a folder of pictures')
    controls = t.table("controls")
    settings = SourceSettings(
        device=device if DEVICE_KIND.match(device) else str(folder / device),
        input=t.text("input", None),
        standard=t.choice("standard", Standard, Standard.NONE),
        lock=_automatics(t),
        controls={name: controls.number(name) for name in controls.values},
    )
    t.finish()
    return settings


def _automatics(t: Table) -> tuple[str, ...]:
    names: tuple[str, ...] = t.texts("lock", ())
    if unknown := [name for name in names if name not in AUTOMATICS]:
        raise t.error("lock", f"{unknown[0]!r} is no automatic; known: {', '.join(AUTOMATICS)}")
    return names


def _generator(t: Table, folder: Path) -> SteamGenerator:
    name = t.text("name")
    t.finish()
    try:
        return load_generator(str(folder / name) if name.endswith(".toml") else name)
    except ConfigError as error:
        raise t.error("name", str(error)) from None


def _camera(t: Table, folder: Path) -> Camera | None:
    name = t.text("file", None)
    t.finish()
    if name is None:
        return None
    try:
        return read_camera(folder / name)
    except ConfigError as error:
        raise t.error("file", str(error)) from None


def _measuring(t: Table) -> MeasuringSettings:
    default = MeasuringSettings()
    settings = MeasuringSettings(
        field_order=t.choice("field_order", FieldOrder, default.field_order),
        oldest_frame_ms=t.number("oldest_frame_ms", default.oldest_frame_ms, minimum=20, maximum=60_000),
    )
    t.finish()
    return settings


def _viewer(t: Table) -> ViewerSettings:
    default = ViewerSettings()
    address = t.text("address", default.address)
    if not _is_loopback(address):
        raise t.error("address", "must be a loopback address such as 127.0.0.1: the viewer asks nobody for a password")
    settings = ViewerSettings(
        enabled=t.flag("enabled", default.enabled),
        address=address,
        port=t.integer("port", default.port, minimum=1, maximum=65535),
        web_port=t.integer("web_port", default.web_port, minimum=1, maximum=65535),
        open_browser=t.flag("open_browser", default.open_browser),
        memory_mib=t.integer("memory_mib", default.memory_mib, minimum=16, maximum=65536),
    )
    t.finish()
    return settings


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.IPv4Address(address).is_loopback
    except ValueError:
        return False
