"""A session's description, session.toml: written once, at its beginning."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import tomli_w

from drivers.errors import ConfigError
from service.config.cameras import write_atomically
from service.config.table import read_toml
from service.sinks.session.places import ABOUT, CONFIG
from service.sinks.session.surroundings import utc_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

__all__ = ["SCHEMA", "SessionAbout", "file_sha256", "read_about", "unknown_about", "write_about"]

SCHEMA = 1


@dataclass(frozen=True, slots=True)
class SessionAbout:
    """What was recorded, when, by whom, and with what.

    Attributes
    ----------
    what
        LIVE, REPLAY or SIMULATED.
    started_utc, utc_source
        When recording began, and where that time comes from.
    from_start
        Whether recording began with the first frame: only then do results follow from the frames alone.
    operator, generator, steam_generator, leg
        Who, and where; "" for what nobody said.
    anchors, target
        What the command line said besides the station file; "" for no target.
    results_schema
        Of the lines in the result log.
    device, software, machine
        See `surroundings`.
    configuration_sha256, files
        Of all files in the folder `config` together, and of each.
    """

    what: str
    started_utc: str
    utc_source: str
    from_start: bool
    operator: str
    generator: str
    steam_generator: str
    leg: str
    results_schema: int
    configuration_sha256: str
    anchors: Sequence[str] = ()
    target: str = ""
    device: Mapping[str, Any] = field(default_factory=dict)
    software: Mapping[str, str] = field(default_factory=dict)
    machine: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)


def unknown_about(folder: Path, began_ns: int) -> SessionAbout:
    """What can be told of a session whose description cannot be read: of what lies in its folder now, sound or not.

    Parameters
    ----------
    began_ns
        When its first frame was received, UTC since 1970.
    """
    files = {str(path.relative_to(folder / CONFIG)): path for path in sorted((folder / CONFIG).rglob("*.toml"))}
    return SessionAbout(
        what="UNKNOWN",
        started_utc=utc_text(began_ns),
        utc_source="source of the time unknown",
        from_start=True,
        operator="",
        generator="",
        steam_generator="",
        leg="",
        results_schema=0,
        configuration_sha256="unknown",
        files={name: file_sha256(path) for name, path in files.items()},
    )


def write_about(folder: Path, about: SessionAbout) -> str:
    """Write it; gives the file's SHA-256."""
    values = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(about).items()}
    text = tomli_w.dumps({"schema": SCHEMA, **values})
    write_atomically(folder / ABOUT, text)
    return hashlib.sha256(text.encode()).hexdigest()


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, however large; raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_about(folder: Path) -> SessionAbout:
    """Read it; raises ConfigError where it is not there, or not sound."""
    t = read_toml(folder / ABOUT)
    schema = t.integer("schema", minimum=1)
    if schema > SCHEMA:
        raise t.error("schema", f"this Bowlsight reads {SCHEMA}; use a later one")
    names = ("what", "started_utc", "utc_source", "operator", "generator", "steam_generator", "leg")
    about = SessionAbout(
        **{name: t.text(name) for name in names},
        from_start=t.flag("from_start"),
        results_schema=t.integer("results_schema", minimum=1),
        configuration_sha256=t.text("configuration_sha256"),
        anchors=t.texts("anchors", ()),
        target=t.text("target", ""),
        device=t.table("device").values,
        software=t.table("software").values,
        machine=t.table("machine").values,
        files=t.table("files").values,
    )
    t.finish()
    if not all(isinstance(digest, str) for digest in about.files.values()):
        raise ConfigError(f"{folder / ABOUT}: files: must be names with their SHA-256")
    return about
