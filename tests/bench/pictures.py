"""What the bench is run on: pictures in a row with exact truth, rendered here, or kept beside the project."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from drivers.rendering import Renderer, add_noise, quantised
from drivers.scene import ABSENT, CLEAN, GENERATORS, NOMINAL, OPEN, Look, TubeLattice
from drivers.simulation import Scene, default_scene
from service.vision.camera import Camera, OpenCVLens, TsaiLens
from service.vision.lattice import Arrangement, Lattice
from tests.scenes.rendered import camera_of, lattice_of, looking, optics_of, sheet_of

ROOM = {"triangular": 3**0.5 / 2, "square": 1.0}
"""Area of a lattice cell over the pitch squared."""
WHOLE = 0.99


@dataclass(frozen=True, eq=False)
class Truth:
    """Centres, (n, 2) px, of what stands in a picture; `open` tubes that are wholly seen must be found, others may."""

    center_px: np.ndarray
    open: np.ndarray
    rotation: np.ndarray
    translation_mm: np.ndarray


@dataclass(frozen=True, eq=False)
class Take:
    """Pictures of one camera in a row."""

    name: str
    camera: Camera
    lattice: Lattice
    period_ns: int
    pictures: list[np.ndarray]
    truth: list[Truth]
    pattern: tuple[int, int] | None = None
    """(columns, rows) where the picture shows just so many tubes, as findCirclesGrid wants it."""

    def there_and_back(self) -> Iterator[int]:
        """Numbers of pictures without end, at the pace they were taken."""
        last = len(self.pictures) - 1
        way = [*range(last), *range(last, 0, -1)] or [0]
        while True:
            yield from way

    @property
    def tubes(self) -> int:
        return round(float(np.median([len(t.center_px) for t in self.truth])))

    @property
    def pitch_px(self) -> float:
        center = self.truth[0].center_px
        off = np.linalg.norm(center[:, None] - center[None], axis=2)
        np.fill_diagonal(off, np.inf)
        return float(np.median(off.min(axis=1)))

    @property
    def radius_px(self) -> float:
        return self.pitch_px * self.lattice.rim_radius_mm / self.lattice.pitch_mm


def pitch_for(tubes: int, size_px: tuple[int, int], arrangement: str) -> float:
    """Pitch, px, at which a picture shows so many tubes."""
    return float((size_px[0] * size_px[1] / tubes / ROOM[arrangement]) ** 0.5)


def scene_of(
    size_px: tuple[int, int], tubes: int, *, look: Look = NOMINAL, generator: str = "system80", count: int = 24,
    rate_hz: float = 25.0, seed: int = 3,
) -> Scene:  # fmt: skip
    """A camera that pans to and fro over the sheet, at rest at both ends of `count` pictures."""
    lattice = GENERATORS[generator]
    pitch_px = pitch_for(tubes, size_px, lattice.arrangement)
    return default_scene(
        lattice, np.random.default_rng(seed), size_px=size_px, rate_hz=rate_hz, frames=max(1, count - 1),
        look=replace(look, hose=False), pitch_px=pitch_px,
    )  # fmt: skip


def rendered(name: str, size_px: tuple[int, int], tubes: int, *, count: int = 24, **scene_settings) -> Take:
    """Pictures of `scene_of`."""
    scene = scene_of(size_px, tubes, count=count, **scene_settings)
    return Take(
        name, camera_of(scene.optics), lattice_of(scene.sheet.lattice, scene.look), round(1e9 / scene.rate_hz),
        [scene.picture(k) for k in range(count)], [_truth(scene, k) for k in range(count)],
    )  # fmt: skip


def _truth(scene: Scene, number: int) -> Truth:
    index, center, visible = scene.tubes_in_view(number)
    is_open = (scene.sheet.states.ravel()[index] == OPEN) & (visible > WHOLE)
    return Truth(center, is_open, *scene.pose(number))


def card(count: int = 12, *, columns: int = 9, rows: int = 7) -> Take:
    """A plate with just so many bores, evenly lit, nothing else on it: what findCirclesGrid is made for."""
    tubes = TubeLattice("square", 25.4, 8.0, 9.0)
    look = replace(CLEAN, texture=0.0, plugged=0.0, ambient=1.0, plate=0.7, rim=0.7, weld_mm=0.0, wall=0.0)
    optics = optics_of((640, 480), pitch_px=50.0, bend=0.01)
    sheet = sheet_of(tubes, look, reach=12)
    row, column = np.mgrid[-12:13, -12:13]
    there = (abs(row) <= rows // 2) & (abs(column) <= columns // 2)
    sheet = replace(sheet, states=np.where(there, OPEN, ABSENT))
    renderer = Renderer(optics, sheet, look, np.random.default_rng(0))
    pictures, truth = [], []
    for k in range(count):
        pose = looking(
            6.0 + 2.0 * k / count, roll_deg=4.0 + 4.0 * k / count, at_mm=(20.0 * k / count, 10.0 * k / count)
        )
        noisy = add_noise(renderer.draw(*pose), look, np.random.default_rng(k))
        pictures.append(quantised(noisy, 8))
        center = optics.project(*pose, sheet.centers_mm[there])
        truth.append(Truth(center, np.ones(len(center), bool), *pose))
    lattice = lattice_of(tubes, look)
    return Take("dot card 640x480", camera_of(optics), lattice, 40_000_000, pictures, truth, (columns, rows))


def stills(folder: Path) -> list[Take]:
    """Every picture of known truth in a folder, a take each."""
    return [_still(path) for path in sorted(folder.glob("*.json")) if path.with_suffix(".png").exists()]


def _still(path: Path) -> Take:
    told = json.loads(path.read_text())
    c = told["camera"]
    bent = c["distortion"]
    lens = OpenCVLens(tuple(bent["coeffs"])) if "coeffs" in bent else TsaiLens(bent["kappa1_per_mm2"])
    camera = Camera((c["width"], c["height"]), tuple(c["pixel_mm"]), c["focal_mm"], lens, (c["K"][0][2], c["K"][1][2]))
    tubes = [t for t in told["tubes"] if t["state"] != "absent" and t.get("centre_in_image", True)]
    clear = [t["state"] == "open" and t.get("visible_fraction", 1.0) > WHOLE for t in tubes]
    truth = Truth(
        np.array([t["px"] for t in tubes]), np.array(clear), np.array(c["R"]), np.array(c["t"]),
    )  # fmt: skip
    lattice = Lattice(Arrangement(told["pattern"]), told["pitch_mm"], told["rim_radius_mm"], told["tube_od_mm"] / 2)
    picture = cv2.imread(str(path.with_suffix(".png")), cv2.IMREAD_GRAYSCALE)
    return Take(told["grade"], camera, lattice, 40_000_000, [picture], [truth])
