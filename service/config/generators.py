"""Steam generators: what is known of a tubesheet before the first picture."""

from __future__ import annotations

import difflib
import enum
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import ConfigError
from service.config.shipped import shipped_config
from service.config.table import Table, read_toml
from service.vision.lattice import Arrangement, Lattice

__all__ = ["Naming", "SteamGenerator", "generator_names", "load_generator"]


class Naming(enum.StrEnum):
    """How a plant names a tube: L83R87, or ROW12 COL34."""

    LINE_ROW = "line-row"
    ROW_COLUMN = "row-column"


@dataclass(frozen=True, slots=True)
class SteamGenerator:
    """One table of `config/steam_generators.toml`."""

    key: str
    label: str
    plants: tuple[str, ...]
    tubes: int
    material: str
    naming: Naming
    tube_outer_diameter_mm: float
    wall_mm: float
    lattice: Lattice


def load_generator(name: str) -> SteamGenerator:
    """Find a steam generator by its table's name, or read it from a file with one table.

    Raises
    ------
    ConfigError
        No such name or file, or the table is not sound.
    """
    if name.endswith(".toml") or "/" in name:
        document = read_toml(Path(name))
        if len(document.values) != 1:
            raise ConfigError(f"{name}: holds {len(document.values)} tables; a steam generator's file has one")
        (key,) = document.values
        return _generator(document.table(key, required=True), key)
    document = read_toml(shipped_config("steam_generators.toml"))
    if name not in document:
        near = difflib.get_close_matches(name.lower(), document.values, 1, 0.4)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ConfigError(
            f"steam generator {name!r}: unknown; {hint}known: {', '.join(document.values)}, or a .toml file"
        )
    return _generator(document.table(name, required=True), name)


def generator_names() -> list[str]:
    """Names of the steam generators that are shipped."""
    return list(read_toml(shipped_config("steam_generators.toml")).values)


def _generator(t: Table, key: str) -> SteamGenerator:
    pitch = t.number("pitch_mm", above=0)
    outer = t.number("tube_outer_diameter_mm", above=0)
    wall = t.number("wall_mm", above=0)
    if outer >= pitch:
        raise t.error("tube_outer_diameter_mm", f"must be below pitch_mm = {pitch:g}: tubes do not overlap")
    if 2 * wall >= outer:
        raise t.error("wall_mm", f"must be below half of tube_outer_diameter_mm = {outer:g}")
    generator = SteamGenerator(
        key=key,
        label=t.text("label", key),
        plants=t.texts("plants", ()),
        tubes=t.integer("tubes", 0, minimum=0),
        material=t.text("material", ""),
        naming=t.choice("naming", Naming, Naming.ROW_COLUMN),
        tube_outer_diameter_mm=outer,
        wall_mm=wall,
        lattice=Lattice(
            arrangement=t.choice("arrangement", Arrangement),
            pitch_mm=pitch,
            rim_radius_mm=outer / 2 - wall,
            outer_radius_mm=outer / 2,
            scatter_mm=t.number("tube_scatter_mm", 0.05, minimum=0, maximum=pitch / 10),
            height_scatter_mm=t.number("tube_height_scatter_mm", 0.15, minimum=0, maximum=pitch / 4),
            pitch_sigma_mm=t.number("pitch_sigma_mm", 0.0, minimum=0, maximum=pitch / 10),
        ),
    )
    t.finish()
    return generator
