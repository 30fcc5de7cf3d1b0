"""What an evidence record says of one result: which tube, how far off, how sure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from service.alignment.targets import nearest_place
from service.identity.names import NamingError

if TYPE_CHECKING:
    from service.identity.counting import NamingRule
    from service.results import FrameResult

__all__ = ["CalibrationUsed", "EvidenceContext", "claim_and_sight", "figures", "identity"]


@dataclass(frozen=True, slots=True)
class CalibrationUsed:
    """The camera file that results rest on; all None where nothing is known of the camera.

    Attributes
    ----------
    name, sha256
        Of the camera, and of its file.
    reprojection_error_px, calibrated_utc
        What the calibration said of itself.
    """

    name: str | None = None
    sha256: str | None = None
    reprojection_error_px: float | None = None
    calibrated_utc: str | None = None

    def at(self, wall_ns: int) -> dict[str, Any]:
        """As a record has it, with its age at that time."""
        age = None if self.calibrated_utc is None else _age_days(self.calibrated_utc, wall_ns)
        return {
            "name": self.name,
            "sha256": self.sha256,
            "reprojection_error_px": self.reprojection_error_px,
            "calibrated_utc": self.calibrated_utc,
            "age_days": age,
        }


def _age_days(calibrated_utc: str, wall_ns: int) -> float | None:
    try:
        then = datetime.fromisoformat(calibrated_utc)
    except ValueError:
        return None
    then = then if then.tzinfo else then.replace(tzinfo=UTC)
    return round((wall_ns / 1e9 - then.timestamp()) / 86400, 3)


@dataclass(frozen=True, slots=True, eq=False)
class EvidenceContext:
    """What all records of a session have in common.

    Attributes
    ----------
    what
        LIVE, REPLAY or SIMULATED.
    rule
        How tubes are named here, on which lattice.
    map_sha256
        Of the tubesheet map's file; None without a map.
    calibration
        The camera file.
    software
        Bowlsight's version.
    configuration_sha256
        Of the session's copy of the configuration.
    """

    what: str
    rule: NamingRule
    map_sha256: str | None = None
    calibration: CalibrationUsed = field(default_factory=CalibrationUsed)
    software: str = ""
    configuration_sha256: str = ""


def identity(context: EvidenceContext) -> dict[str, Any]:
    """Where it is, and what is known of the tubes there."""
    rule, known = context.rule, context.rule.map
    about_map = None
    if known is not None:
        about_map = {"name": known.name, "sha256": context.map_sha256, "approximate": known.approximate}
    return {
        "what": context.what,
        "steam_generator": rule.steam_generator or None,
        "leg": None if rule.leg is None else str(rule.leg),
        "map": about_map,
    }


def claim_and_sight(context: EvidenceContext, result: FrameResult, claim: str | None) -> dict[str, Any]:
    """The tube claimed, the tube that the guide's axis is nearest to by the picture, and whether they agree."""
    named = None if claim is None else _canonical(context, claim)
    place, margin_mm = _seen(context, result)
    seen = None if place is None else _name_at(result, place)
    return {
        "tube_claimed": named,
        "tube_seen": seen,
        "place_seen": None if place is None else list(place),
        "margin_mm": margin_mm,
        "agrees": None if named is None or seen is None else named == seen,
    }


def _canonical(context: EvidenceContext, claim: str) -> str:
    try:
        return str(context.rule.parse(claim))
    except NamingError:
        return " ".join(claim.split())


def _seen(context: EvidenceContext, result: FrameResult) -> tuple[tuple[int, int] | None, float | None]:
    """Lattice place of the tube nearest to the guide's axis, and how much nearer it is than the second, mm."""
    alignment = result.alignment
    if alignment is None or alignment.place is None or alignment.lean is None:
        return None, None
    lattice = context.rule.lattice
    tube = lattice.sheet_points(np.array([alignment.place[0]]), np.array([alignment.place[1]]))[0]
    foot = tube + alignment.lean.offset_mm
    place = nearest_place(foot, lattice, result.measurement.tubes)
    rows, columns = (g.ravel() for g in np.mgrid[place[0] - 2 : place[0] + 3, place[1] - 2 : place[1] + 3])
    away = np.linalg.norm(lattice.sheet_points(rows, columns) - foot, axis=1)
    here = (rows == place[0]) & (columns == place[1])
    return place, round(float(away[~here].min() - away[here][0]), 4)


def _name_at(result: FrameResult, place: tuple[int, int]) -> str | None:
    tubes = result.measurement.tubes
    at = np.flatnonzero((tubes.row == place[0]) & (tubes.column == place[1]))
    return result.names[at[0]] if len(at) and result.names else None


def figures(result: FrameResult) -> dict[str, Any]:
    """Verdict, offset and tilt with their sigmas, and how far the picture is to be trusted."""
    m, a = result.measurement, result.alignment
    lean = None if a is None else a.lean
    return {
        "lock": str(m.lock),
        "doubt": [str(d) for d in m.doubt],
        "verdict": None if a is None else str(a.verdict),
        "quality": None if a is None else a.quality,
        "offset_mm": None if lean is None else [round(v, 5) for v in lean.offset_mm.tolist()],
        "offset_sigma_mm": None if lean is None else _finite(lean.offset_sigma_mm),
        "tilt_deg": None if lean is None else _finite(lean.tilt_deg),
        "tilt_sigma_deg": None if lean is None else _finite(lean.tilt_sigma_deg),
        "camera_tilt_deg": None if m.pose is None else _finite(m.pose.tilt_deg),
        "camera_tilt_sigma_deg": None if m.pose is None else _finite(m.pose.sigma.tilt_deg),
        "distance_mm": None if m.pose is None else _finite(m.pose.distance_mm),
        "distance_sigma_mm": None if m.pose is None else _finite(m.pose.sigma.distance_mm),
    }


def _finite(value: float) -> float | None:
    return round(value, 5) if math.isfinite(value) else None
