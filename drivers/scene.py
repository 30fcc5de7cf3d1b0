"""What stands before the simulated camera: the tubesheet, its light, the hose across it; all of it exactly known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["ABSENT", "GENERATORS", "LOOKS", "OPEN", "PLUGGED", "Hose", "Look", "Sheet", "TubeLattice", "make_sheet"]

ABSENT: Final = 0
OPEN: Final = 1
PLUGGED: Final = 2

_S, _H = math.sqrt(3) / 2, math.sqrt(0.5)
_BASIS = {
    "triangular": ((1.0, 0.0), (0.5, _S)),
    "rotated-triangular": ((0.0, 1.0), (-_S, 0.5)),
    "square": ((1.0, 0.0), (0.0, 1.0)),
    "rotated-square": ((_H, _H), (-_H, _H)),
}


@dataclass(frozen=True, slots=True)
class TubeLattice:
    """A steam generator's tubes, mm. `model` is what truth files call it."""

    arrangement: str
    pitch_mm: float
    rim_radius_mm: float
    outer_radius_mm: float
    model: str = "custom"
    label: str = "custom"

    def __post_init__(self) -> None:
        if self.arrangement not in _BASIS:
            raise ValueError(f"arrangement = {self.arrangement!r}: must be one of {', '.join(_BASIS)}")
        if not 0 < self.rim_radius_mm < self.outer_radius_mm < self.widest_mm:
            raise ValueError(
                f"rim_radius_mm = {self.rim_radius_mm}, outer_radius_mm = {self.outer_radius_mm}: must rise from 0 "
                f"to below 0.43 pitches ({self.widest_mm:.3g} mm)"
            )

    @property
    def basis_mm(self) -> NDArray[np.float64]:
        """Lattice vectors as rows, (2, 2): one column on, one row on."""
        return np.array(_BASIS[self.arrangement]) * self.pitch_mm

    @property
    def widest_mm(self) -> float:
        """Largest radius around a tube's axis that rounding its lattice coordinates finds, in every arrangement."""
        return 0.43 * self.pitch_mm


def _inches(model: str, label: str, arrangement: str, pitch: float, outer_diameter: float, wall: float) -> TubeLattice:
    outer = 12.7 * outer_diameter
    return TubeLattice(arrangement, 25.4 * pitch, outer - 25.4 * wall, outer, model, label)


GENERATORS: Final = {
    "delta60": _inches("W_Delta60", "W/H Delta 60", "triangular", 1.10, 0.750, 0.0440),
    "model-f": _inches("W_F", "W/H F", "square", 0.98, 0.688, 0.0400),
    "51b": _inches("FT_51B", "F/T 51B", "square", 1.28, 0.875, 0.0500),
    "system80": _inches("System80", "System 80", "triangular", 1.00, 0.750, 0.0420),
    "candu6": _inches("CANDU6", "CANDU 6", "triangular", 0.95, 0.625, 0.0445),
}
"""Table 1 of the paper, by the names that `config/steam_generators.toml` gives them."""


@dataclass(frozen=True, slots=True)
class Look:
    """How things look. Brightness as a share of full scale under full light.

    Attributes
    ----------
    plate, weld, rim, plug
        Clad plate, weld bead around the tube, machined tube end, plug's face.
    texture
        Contrast of stains and machining marks; 0 for none.
    weld_mm
        Width of the bead.
    wall, wall_depth_mm
        Brightness of the bore's wall at its mouth, and how deep light falls to 1/e of it.
    ambient, spot
        Light far from the lamp's spot, and the spot's radius (one sigma) in picture widths; infinity for even light.
    glare
        Mirror-like reflection of the lamp where its ray meets the sheet at a right angle.
    blur_px
        One sigma of the lens's and sensor's point spread.
    read_noise, shot_noise
        One sigma of noise, in 8-bit steps: in the dark, and added at full scale.
    specks
        Radiation specks a frame, on average.
    scatter_mm, height_scatter_mm
        One sigma of the tube ends' places in the plane, per axis, and of their height.
    plugged, absent
        Share of the tubes.
    lane_rows
        Rows left out for the divider lane.
    hose
        Whether a hose hangs across.
    """

    plate: float = 0.42
    weld: float = 0.30
    rim: float = 0.85
    plug: float = 0.75
    texture: float = 0.25
    weld_mm: float = 1.0
    wall: float = 0.2
    wall_depth_mm: float = 4.0
    ambient: float = 0.25
    spot: float = 0.45
    glare: float = 0.2
    blur_px: float = 0.8
    read_noise: float = 1.5
    shot_noise: float = 3.0
    specks: float = 1.0
    scatter_mm: float = 0.05
    height_scatter_mm: float = 0.15
    plugged: float = 0.03
    absent: float = 0.01
    lane_rows: int = 2
    hose: bool = True


CLEAN = Look(
    texture=0.1, ambient=0.6, glare=0.0, read_noise=0.8, shot_noise=1.0, specks=0.0, scatter_mm=0.0,
    height_scatter_mm=0.0, plugged=0.02, absent=0.0, lane_rows=0, hose=False,
)  # fmt: skip
NOMINAL = Look()
HARD = replace(
    NOMINAL, texture=0.45, ambient=0.05, spot=0.3, glare=0.7, blur_px=1.3, read_noise=4.0, shot_noise=6.0, specks=40.0
)
LOOKS: Final = {"clean": CLEAN, "nominal": NOMINAL, "hard": HARD}


@dataclass(frozen=True, slots=True, eq=False)
class Hose:
    """A tube of `radius_mm` along `points_mm`, (n, 3) in the sheet frame, between camera and sheet."""

    points_mm: NDArray[np.float64]
    radius_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """The tubes of a rectangle of lattice sites.

    Attributes
    ----------
    lattice
        Its nominal geometry.
    first
        (row, column) of the rectangle's first site.
    centers_mm
        (rows, columns, 3): where each rim's centre really is.
    states
        (rows, columns): OPEN, PLUGGED or ABSENT.
    gloss
        (rows, columns): brightness of each tube end against the others.
    hose
        What hangs across, or None.
    """

    lattice: TubeLattice
    first: tuple[int, int]
    centers_mm: NDArray[np.float64]
    states: NDArray[np.int_]
    gloss: NDArray[np.float64]
    hose: Hose | None = field(default=None)

    def nominal_mm(self) -> NDArray[np.float64]:
        """(rows, columns, 2): where the sites are on the drawing."""
        return _nominal(self.lattice, self.first, self.states.shape)


def _nominal(lattice: TubeLattice, first: tuple[int, int], shape: tuple[int, ...]) -> NDArray[np.float64]:
    rows, columns = np.mgrid[first[0] : first[0] + shape[0], first[1] : first[1] + shape[1]]
    return np.stack([columns, rows], axis=-1) @ lattice.basis_mm


def make_sheet(
    lattice: TubeLattice, first: tuple[int, int], shape: tuple[int, int], look: Look, rng: np.random.Generator
) -> Sheet:
    """Draw a rectangle of `shape` (rows, columns) tubes: scatter, plugs, places without a tube, the lane, a hose."""
    scatter = rng.standard_normal((*shape, 3)) * (look.scatter_mm, look.scatter_mm, look.height_scatter_mm)
    centers = scatter
    centers[..., :2] += _nominal(lattice, first, shape)
    luck = rng.random(shape)
    states = np.where(luck < look.plugged, PLUGGED, np.where(luck < look.plugged + look.absent, ABSENT, OPEN))
    if look.lane_rows:
        lane = int(rng.integers(shape[0] // 4, max(shape[0] // 4 + 1, 3 * shape[0] // 4)))
        states[lane : lane + look.lane_rows] = ABSENT
    gloss = np.clip(1 + 0.12 * rng.standard_normal(shape), 0.7, 1.2) if look.texture else np.ones(shape)
    return Sheet(lattice, first, centers, states, gloss, _make_hose(centers, lattice, rng) if look.hose else None)


def _make_hose(centers_mm: NDArray[np.float64], lattice: TubeLattice, rng: np.random.Generator) -> Hose:
    """A slack curve across the middle of the sheet's rectangle, three to eight pitches before it."""
    low, high = centers_mm.reshape(-1, 3).min(axis=0), centers_mm.reshape(-1, 3).max(axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm((high - low)[:2]))
    angle = rng.uniform(0, math.tau)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    s = np.linspace(-0.6, 0.6, 25)[:, None] * reach
    bend = lattice.pitch_mm * (rng.uniform(-4, 4) + 2 * np.sin(s / reach * rng.uniform(4, 9)))
    height = -lattice.pitch_mm * rng.uniform(3, 8) * np.ones_like(s)
    points = np.concatenate([middle[:2] + s * along + bend * across, height], axis=1)
    return Hose(points, lattice.pitch_mm * rng.uniform(0.35, 0.6))
