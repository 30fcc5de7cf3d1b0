"""What is to be recorded, with what is known of it before the first frame."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from service import __version__
from service.config.cameras import read_camera
from service.config.recording import RecordingSettings, default_folder
from service.config.table import read_toml
from service.results import SCHEMA as RESULTS_SCHEMA
from service.sinks.evidence_record import CalibrationUsed, EvidenceContext
from service.sinks.session.about import SessionAbout
from service.sinks.session.configuration import joint_sha256
from service.sinks.session.places import CONFIG, make_folder
from service.sinks.session.surroundings import machine, software, utc_source, utc_text
from service.sinks.session.writer import SessionWriter

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from service.identity.counting import NamingRule
    from service.sinks.session.configuration import Configuration

__all__ = ["RecordingPlan", "Session"]


@dataclass(frozen=True, slots=True, eq=False)
class RecordingPlan:
    """What every session of this run has in common.

    Attributes
    ----------
    settings
        [recording], with what the command line said.
    what
        LIVE, REPLAY or SIMULATED.
    generator
        Its name.
    configuration
        All that results depend on, but for the frames.
    rule
        How tubes are named.
    anchors, target
        What the command line said besides.
    verify_every_s
        Put a frame on record this often; None: only where somebody asks.
    """

    settings: RecordingSettings
    what: str
    generator: str
    configuration: Configuration
    rule: NamingRule
    anchors: Sequence[str] = ()
    target: str | None = None
    verify_every_s: float | None = None

    @property
    def root(self) -> Path:
        """The folder of sessions."""
        return self.settings.folder or default_folder()

    def begin(
        self, device: Mapping[str, Any], *, from_start: bool, wall_ns: Callable[[], int] = time.time_ns
    ) -> Session:
        """Make a session's folder with all that is known at its beginning.

        Raises
        ------
        ConfigError
            It cannot be made there.
        OSError
            There is no room for it.
        """
        began_ns = wall_ns()
        folder = make_folder(self.root, began_ns, self.generator)
        files = self.configuration.write(folder / CONFIG)
        about = SessionAbout(
            what=self.what,
            started_utc=utc_text(began_ns),
            utc_source=utc_source(),
            from_start=from_start,
            operator=self.settings.operator,
            generator=self.generator,
            steam_generator=self.rule.steam_generator,
            leg=str(self.rule.leg or ""),
            results_schema=RESULTS_SCHEMA,
            configuration_sha256=joint_sha256(files),
            anchors=tuple(self.anchors),
            target=self.target or "",
            device=device,
            software=software(),
            machine=machine(),
            files=files,
        )
        writer = SessionWriter(folder, about, csv=self.settings.csv, wall_ns=wall_ns)
        return Session(writer, self._context(folder, about))

    def _context(self, folder: Path, about: SessionAbout) -> EvidenceContext:
        known = self.rule.map
        named = {name.partition("/")[0]: name for name in about.files if "/" in name}
        return EvidenceContext(
            what=self.what,
            rule=self.rule,
            map_sha256=None if known is None else about.files.get(named.get("map", "")),
            calibration=_calibration(folder / CONFIG, named.get("camera"), about.files),
            software=__version__,
            configuration_sha256=about.configuration_sha256,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """A session that was begun: what writes it, and what its evidence has in common."""

    writer: SessionWriter
    context: EvidenceContext


def _calibration(folder: Path, name: str | None, files: Mapping[str, str]) -> CalibrationUsed:
    if name is None:
        return CalibrationUsed()
    t = read_toml(folder / name)
    return CalibrationUsed(
        name=read_camera(folder / name).name,
        sha256=files[name],
        reprojection_error_px=t.number("reprojection_error_px", None),
        calibrated_utc=t.text("calibrated_utc", None),
    )
