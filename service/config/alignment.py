"""[identity] and [alignment] of a station file."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from drivers.errors import ConfigError
from service.alignment.aligner import AlignmentSettings
from service.alignment.bands import Bands
from service.alignment.geometry import StationGeometry
from service.alignment.targets import parse_target
from service.config.guide import read_guide
from service.identity.counting import Growth, NamingRule
from service.identity.maps import load_map
from service.identity.names import Leg

if TYPE_CHECKING:
    import enum
    from pathlib import Path

    from service.alignment.geometry import GuideAxis
    from service.config.generators import SteamGenerator
    from service.config.table import Table
    from service.identity.maps import TubesheetMap

__all__ = ["GuideSettings", "IdentitySettings", "read_alignment", "read_identity"]

E = TypeVar("E", bound="enum.StrEnum")
GENERATOR_NAME = re.compile(r"[A-Za-z][A-Za-z0-9 -]{0,15}")
SAME_PITCH = 0.01
HORIZONTAL = (Growth.LEFT, Growth.RIGHT)


@dataclass(frozen=True, slots=True)
class IdentitySettings:
    """[identity]; see `NamingRule`."""

    steam_generator: str = ""
    leg: Leg | None = None
    rows_grow: Growth | None = None
    columns_grow: Growth | None = None
    rows_along: bool = True
    map: TubesheetMap | None = None

    def rule(self, generator: SteamGenerator) -> NamingRule:
        """How this plant names the tubes of that steam generator; raises ConfigError where the map is another's."""
        lattice, known = generator.lattice, self.map
        if known is not None and (
            known.arrangement is not lattice.arrangement or abs(known.pitch_mm / lattice.pitch_mm - 1) > SAME_PITCH
        ):
            raise ConfigError(
                f"[identity] map {known.name} is {known.arrangement} with a pitch of {known.pitch_mm:g} mm, but steam"
                f" generator {generator.key} is {lattice.arrangement} with {lattice.pitch_mm:g} mm; give its own map"
            )
        return NamingRule(
            naming=generator.naming,
            lattice=generator.lattice,
            rows_along=self.rows_along,
            rows_grow=self.rows_grow,
            columns_grow=self.columns_grow,
            steam_generator=self.steam_generator,
            leg=self.leg,
            map=self.map,
        )


@dataclass(frozen=True, slots=True, eq=False)
class GuideSettings:
    """[alignment], but for what follows from the steam generator."""

    guide: GuideAxis
    probe_diameter_mm: float
    tube_diameter_mm: float | None
    gap_mm: float | None
    gap_sigma_mm: float
    arm_normal: tuple[float, float, float] | None
    bands: Bands
    target: str
    stale_after_s: float
    average_s: float

    def settings(self, generator: SteamGenerator) -> AlignmentSettings:
        """For that steam generator's tubes; raises ConfigError where the probe does not go into them."""
        tube = self.tube_diameter_mm or 2 * generator.lattice.rim_radius_mm
        if self.probe_diameter_mm >= tube:
            raise ConfigError(
                f"[alignment] probe_diameter_mm = {self.probe_diameter_mm:g}: does not go into a tube of"
                f" {generator.label}, inner diameter {tube:.2f} mm; give that of this probe"
            )
        normal = self.guide.direction if self.arm_normal is None else np.array(self.arm_normal)
        return AlignmentSettings(
            geometry=StationGeometry(
                guide=self.guide,
                probe_diameter_mm=self.probe_diameter_mm,
                tube_diameter_mm=tube,
                gap_mm=self.gap_mm,
                gap_sigma_mm=self.gap_sigma_mm,
                arm_normal=normal / np.linalg.norm(normal),
            ),
            bands=self.bands,
            target=self.target,
            stale_after_s=self.stale_after_s,
            average_s=self.average_s,
        )


def read_identity(t: Table, folder: Path) -> IdentitySettings:
    """Read [identity]."""
    name = t.text("steam_generator", "")
    if name and not GENERATOR_NAME.fullmatch(name):
        raise t.error("steam_generator", "must begin with a letter, such as SG1; at most 16 letters, digits, blanks, -")
    rows, columns = (_choice(t, key, Growth) for key in ("rows_grow", "columns_grow"))
    if (rows is None) != (columns is None):
        raise t.error("rows_grow", "give both rows_grow and columns_grow, or neither")
    if rows is not None and (rows in HORIZONTAL) == (columns in HORIZONTAL):
        raise t.error("columns_grow", f"must be at a right angle to rows_grow = {str(rows)!r}")
    settings = IdentitySettings(
        steam_generator=name,
        leg=_choice(t, "leg", Leg),
        rows_grow=rows,
        columns_grow=columns,
        rows_along=_rows_along(t),
        map=_map(t, folder),
    )
    t.finish()
    return settings


def _choice(t: Table, key: str, kind: type[E]) -> E | None:
    """One of an enumeration's values; None where it is not given."""
    if key in t:
        return t.choice(key, kind)
    t.text(key, None)
    return None


def _rows_along(t: Table) -> bool:
    said = t.text("counts_along", "rows")
    if said not in ("rows", "columns"):
        raise t.error("counts_along", "must be one of rows, columns")
    return bool(said == "rows")


def _map(t: Table, folder: Path) -> TubesheetMap | None:
    name = t.text("map", None)
    if name is None:
        return None
    try:
        return load_map(str(folder / name) if name.endswith(".toml") else name)
    except ConfigError as error:
        raise t.error("map", str(error)) from None


def read_alignment(t: Table, folder: Path, generator: SteamGenerator, rule: NamingRule) -> GuideSettings | None:
    """Read [alignment]; None where no guide is set up."""
    bands, guide = _bands(t.table("bands")), _guide(t, folder)
    probe = t.number("probe_diameter_mm", None, above=0)
    settings = {
        "tube_diameter_mm": t.number("tube_diameter_mm", None, above=0),
        "gap_mm": t.number("gap_mm", None, minimum=0, maximum=1000),
        "gap_sigma_mm": t.number("gap_sigma_mm", 0.5, minimum=0),
        "arm_normal": t.numbers("arm_normal", 3, None),
        "target": t.text("target", "nearest"),
        "stale_after_s": t.number("stale_after_s", 0.5, minimum=0.05, maximum=10),
        "average_s": t.number("average_s", 1.0, minimum=0.05, maximum=10),
    }
    _check_target(t, settings["target"], rule)
    if settings["arm_normal"] is not None and not any(settings["arm_normal"]):
        raise t.error("arm_normal", "must be a direction, (x, y, z) in the camera frame")
    if guide is not None and probe is None:
        raise t.error("probe_diameter_mm", "missing; give the probe's outer diameter, as guide is set up")
    if guide is not None and not guide.at_mouth and settings["gap_mm"] is None:
        raise t.error("gap_mm", "missing; the guide file does not tell where its mouth is (no mouth_mm in it)")
    t.finish()
    if guide is None:
        return None
    found = GuideSettings(guide=guide, probe_diameter_mm=probe, bands=bands, **settings)
    try:
        found.settings(generator)
    except ConfigError as error:
        raise t.error("probe_diameter_mm", str(error).partition(": ")[2]) from None
    return found


def _guide(t: Table, folder: Path) -> GuideAxis | None:
    name = t.text("guide", None)
    if name is None:
        return None
    try:
        return read_guide(folder / name)
    except ConfigError as error:
        raise t.error("guide", str(error)) from None


def _check_target(t: Table, target: str, rule: NamingRule) -> None:
    try:
        parse_target(target, rule)
    except ConfigError as error:
        raise t.error("target", str(error)) from None


def _bands(t: Table) -> Bands:
    default = Bands()
    bands = Bands(
        **{
            f.name: t.number(f.name, getattr(default, f.name), minimum=0, maximum=10_000)
            if f.name.endswith(("hysteresis_mm", "hysteresis_deg", "margin_sigmas"))
            else t.number(f.name, getattr(default, f.name), above=0, maximum=10_000)
            for f in fields(Bands)
        }
    )
    t.finish()
    for kind, unit in (("offset", "mm"), ("tilt", "deg")):
        normal, advisory, hysteresis, sigma = (
            getattr(bands, f"{kind}_{what}_{unit}") for what in ("normal", "advisory", "hysteresis", "sigma")
        )
        if advisory < normal:
            raise t.error(f"{kind}_advisory_{unit}", f"must be at least {kind}_normal_{unit} = {normal:g}")
        if hysteresis >= normal:
            raise t.error(f"{kind}_hysteresis_{unit}", f"must be below {kind}_normal_{unit} = {normal:g}")
        if sigma > normal:
            raise t.error(
                f"{kind}_sigma_{unit}", f"must not be above {kind}_normal_{unit} = {normal:g}: it could not tell"
            )
    return bands
