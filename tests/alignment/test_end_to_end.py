"""From rendered pictures through the commands: set the guide up, then align with it."""

import json

import cv2
import numpy as np
import pytest

from drivers.optics import Optics
from drivers.rendering import Renderer, add_noise, quantised
from drivers.scene import GENERATORS, NOMINAL, make_sheet
from service.cli import main
from service.cli.simulate import camera_of
from service.config.cameras import write_camera
from service.config.guide import read_guide
from tests.alignment.scenes import turned
from tests.alignment.test_setup import PLAY_MM, TRUE_AXIS, TRUE_POINT, held

TUBES = GENERATORS["model-f"]
OPTICS = Optics(640, 480, 9.6, (0.0056, 0.0056), (322.0, 236.0), kappa1_per_mm2=0.001)
ROD_MM = 2 * (TUBES.rim_radius_mm - PLAY_MM)
STATION = """[source]
device = "x.mp4"
[generator]
name = "model-f"
[identity]
rows_grow = "down"
columns_grow = "right"
[alignment]
guide = "guide.toml"
probe_diameter_mm = 14.2
"""


class Bench:
    """A rendered sheet, seen by a camera that has a guide beside it."""

    def __init__(self, folder):
        self.rng = np.random.default_rng(11)
        look = NOMINAL
        self.sheet = make_sheet(TUBES, (-14, -17), (29, 35), look, self.rng)
        self.renderer = Renderer(OPTICS, self.sheet, look, self.rng)
        self.look, self.folder = look, folder
        write_camera(folder / "camera.toml", camera_of(OPTICS))

    def end_of(self, row, column):
        return self.sheet.centers_mm[row + 14, column + 17]

    def shoot(self, name, R, t):
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        image = add_noise(self.renderer.draw(R, t), self.look, self.rng)
        assert cv2.imwrite(str(path), quantised(image, 8))
        return path

    def standings(self):
        """Six pictures over six tubes, a rod 60 mm deep in each, each from another side."""
        for k, place in enumerate([(0, 0), (2, -1), (-1, 2), (1, 3), (-2, -2), (0, 4)]):
            tilt = np.radians(3) * np.array([np.cos(k), np.sin(k), 0])
            R, t = held(self.rng, turned(tilt), self.end_of(*place), 60.0)
            self.shoot(f"setup/{k}.png", R, t)


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


@pytest.mark.slow
def test_a_guide_measured_by_align_setup_aligns_other_pictures(bench, tmp_path, capsys):
    bench.standings()
    at = OPTICS.project(np.eye(3), np.zeros(3), TRUE_POINT + 50 * TRUE_AXIS / TRUE_AXIS[2])
    common = ["--generator", "model-f", "--camera", str(tmp_path / "camera.toml")]
    guide_px = f"{at[0]:.0f},{at[1]:.0f}"
    options = ["--guide-px", guide_px, "--probe-diameter-mm", str(ROD_MM), "--inserted-mm", "60", "--gap-mm", "30"]
    assert main(["align-setup", str(tmp_path / "setup"), *common, *options, "--out", str(tmp_path / "guide.toml")]) == 0
    assert capsys.readouterr().out.count("60 mm inserted") == 6
    guide = read_guide(tmp_path / "guide.toml")
    turn = np.cross(TRUE_AXIS, guide.direction)
    assert np.linalg.norm(turn) < 3 * np.sqrt(np.trace(guide.covariance[:3, :3]))

    # One millimetre beside another tube, to the right in the picture: the way back is to the left
    (tmp_path / "station.toml").write_text(STATION)
    R, end = turned([0.02, -0.03, 0.0]), bench.end_of(-1, 1)
    passes = TRUE_POINT + 50 * TRUE_AXIS / TRUE_AXIS[2]
    t = passes - R @ np.array([end[0] + 1.0, end[1], 0.0])
    path = bench.shoot("one.png", R, t)
    assert main(["analyze", str(path), *common, "--config", str(tmp_path / "station.toml"), "--jsonl", "-"]) == 0
    alignment = json.loads(capsys.readouterr().out)["alignment"]
    d = R.T @ TRUE_AXIS
    assert alignment["verdict"] == "adjust"
    assert alignment["advice"].startswith("left ")
    assert alignment["offset_mm"] == pytest.approx([1.0, 0.0], abs=3 * alignment["sigma_mm"])
    assert alignment["sigma_mm"] < 0.15
    tilt = np.degrees(np.arctan(np.hypot(*(d[:2] / d[2]))))
    assert alignment["tilt_deg"] == pytest.approx(tilt, abs=3 * alignment["tilt_sigma_deg"])
    assert alignment["entry"]["margin_mm"] < 0
