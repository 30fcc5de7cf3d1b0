"""The configuration that a session was made with, copied whole, so that it can be used again anywhere."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from service.config.cameras import write_atomically, write_camera
from service.config.shipped import shipped_config
from service.config.table import read_toml
from service.sinks.session.places import STATION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from service.config.station import FieldOrder
    from service.vision.camera import Camera

__all__ = ["Configuration", "configuration", "joint_sha256"]

ORIGINAL = "station.original.toml"


@dataclass(frozen=True, slots=True, eq=False)
class Configuration:
    """A station file that names nothing outside its own folder, with what it names.

    Attributes
    ----------
    texts
        Content by path in the folder.
    cameras
        Cameras that came from no file, by path.
    """

    texts: Mapping[str, str]
    cameras: Mapping[str, Camera] = field(default_factory=dict)

    def write(self, folder: Path) -> dict[str, str]:
        """Write all of it; gives each file's SHA-256 by its path in the folder."""
        for name in (*self.texts, *self.cameras):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
        for name, text in self.texts.items():
            write_atomically(folder / name, text)
        for name, camera in self.cameras.items():
            write_camera(folder / name, camera)
        names = sorted([*self.texts, *self.cameras])
        return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}


def joint_sha256(files: Mapping[str, str]) -> str:
    """One hash for all files, from their paths and hashes."""
    lines = "".join(f"{files[name]}  {name}\n" for name in sorted(files))
    return hashlib.sha256(lines.encode()).hexdigest()


def configuration(
    station: Path,
    *,
    device: str | None = None,
    generator: str | None = None,
    camera: Path | Camera | None = None,
    field_order: FieldOrder | None = None,
) -> Configuration:
    """Collect a station file with all that it names; what else is given here replaces what it says.

    Raises
    ------
    ConfigError
        A file cannot be read.
    """
    document, folder = read_toml(station), station.parent
    values: dict[str, Any] = {k: dict(v) if isinstance(v, dict) else v for k, v in document.values.items()}
    copied = _Copies({ORIGINAL: station.read_text(encoding="utf-8")})
    if device is not None:
        values["source"] = {"device": device}
    values["generator"]["name"] = copied.generator(generator, values["generator"]["name"], folder)
    if (named := copied.camera(camera, values.get("camera", {}).get("file"), folder)) is not None:
        values["camera"] = {"file": named}
    if field_order is not None:
        values.setdefault("measuring", {})["field_order"] = str(field_order)
    if (guide := values.get("alignment", {}).get("guide")) is not None:
        values["alignment"]["guide"] = copied.file("guide", folder / guide)
    if (known := values.get("identity", {}).get("map")) is not None:
        shipped = shipped_config(f"tubesheets/{known}.toml")
        values["identity"]["map"] = copied.file("map", folder / known if known.endswith(".toml") else shipped)
    return Configuration({STATION: tomli_w.dumps(values), **copied.texts}, copied.cameras)


class _Copies:
    """Files that the station names, each in a folder of its kind, and under its own name, which may mean something."""

    def __init__(self, texts: dict[str, str]) -> None:
        self.texts = texts
        self.cameras: dict[str, Camera] = {}

    def file(self, kind: str, path: Path) -> str:
        """Copy a TOML file that was read before; gives where it is now."""
        read_toml(path)
        name = f"{kind}/{path.stem}.toml"
        self.texts[name] = path.read_text(encoding="utf-8")
        return name

    def generator(self, given: str | None, named: str, folder: Path) -> str:
        """Copy a steam generator's file, or its table out of those that are shipped."""
        if given is None and named.endswith(".toml"):
            given = str(folder / named)
        chosen = given or named
        if chosen.endswith(".toml") or "/" in chosen:
            return self.file("generator", Path(chosen))
        name = f"generator/{chosen}.toml"
        shipped = read_toml(shipped_config("steam_generators.toml")).values
        self.texts[name] = tomli_w.dumps({chosen: shipped[chosen]})
        return name

    def camera(self, given: Path | Camera | None, named: str | None, folder: Path) -> str | None:
        """Copy a camera's file, or have it written."""
        if given is None and named is None:
            return None
        if given is None or isinstance(given, Path):
            return self.file("camera", given or folder / str(named))
        name = f"camera/{given.name or 'camera'}.toml"
        self.cameras[name] = given
        return name
