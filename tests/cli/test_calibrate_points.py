import json

import numpy as np
import pytest

from drivers.errors import CalibrationError, ConfigError
from service.cli.calibrate_points import run_points
from service.vision.camera import TsaiLens, lens_vector
from service.vision.projection import project

CAMERA = "image_size_px = [640, 480]\npixel_pitch_mm = [0.006, 0.006]\nprincipal_point_px = [322, 241]\n"
COS, SIN = np.cos(0.2), np.sin(0.2)


@pytest.fixture
def camera(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(CAMERA)
    return path


@pytest.fixture
def points(tmp_path):
    """Write a file of points seen at a tilt of 11.5 deg with f = 9 mm."""

    def write(noise_px=0.02, tilted=True, first=None):
        sheet = np.array([[30.0 * i, 30.0 * j] for j in range(7) for i in range(9)])
        R = np.array([[1, 0, 0], [0, COS, -SIN], [0, SIN, COS]]) if tilted else np.eye(3)
        v = lens_vector(1500, 1500, (322.0, 241.0), TsaiLens(-2e-3), 9.0)
        picture = project(v, R, np.array([-110.0, -70.0, 800.0]), sheet)
        picture += np.random.default_rng(0).normal(0, noise_px, picture.shape)
        rows = [f"{x} {y} 0 {u} {w}" for (x, y), (u, w) in zip(sheet.tolist(), picture.tolist(), strict=True)]
        path = tmp_path / "points.dat"
        path.write_text("\n".join(rows[:first]))
        return path

    return write


def test_the_report_is_printed(points, camera, capsys):
    assert run_points(points(), camera) == 0
    out, err = capsys.readouterr()
    assert out.startswith("Coplanar calibration (Tz, f, kappa1 optimization)\n\nf = ")
    assert float(out.split("f = ")[1].split()[0]) == pytest.approx(9.0, rel=0.01)
    for words in ("kappa1 = ", "Tx = -", "Rx = 11.", "\nR\n", "sx = 1.0", "Cx = 322.000000, Cy = 241", "Tz / f = 88."):
        assert words in out
    assert err == ""


@pytest.mark.parametrize("method", ["tsai", "full"])
def test_json_on_standard_output_stands_alone(points, camera, capsys, method):
    assert run_points(points(), camera, method, "-") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["method"] == method
    assert answer["points"] == 63
    assert answer["translation_mm"] == pytest.approx([-110, -70, 800], rel=0.02)


def test_json_goes_to_a_file_beside_the_report(points, camera, capsys, tmp_path):
    assert run_points(points(), camera, json_out=str(tmp_path / "answer.json")) == 0
    assert capsys.readouterr().out.startswith("Coplanar calibration")
    assert json.loads((tmp_path / "answer.json").read_text())["method"] == "tsai"


def test_doubts_go_to_standard_error_where_json_takes_the_output(points, camera, capsys):
    path = points()
    lines = path.read_text().splitlines()
    x, y, z, u, v = lines[20].split()
    lines[20] = f"{x} {y} {z} {float(u) + 4} {v}"
    path.write_text("\n".join(lines))
    assert run_points(path, camera, "full", "-") == 0
    out, err = capsys.readouterr()
    assert json.loads(out)
    assert "points.dat: note: point 21 lies 3" in err


def test_points_that_determine_nothing_are_a_failed_calibration(points, camera):
    with pytest.raises(CalibrationError, match=r"points\.dat: .*cannot be told apart; tilt the camera"):
        run_points(points(noise_px=0.0, tilted=False), camera)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("points.dat", "1 2 3", r"points\.dat:1: '1 2 3': 3 values"),
        ("points.dat", None, r"points\.dat: no such file"),
        ("camera.toml", "image_size_px = 5", r"camera\.toml: image_size_px"),
        ("camera.toml", None, r"camera\.toml: no such file"),
    ],
)
def test_input_that_cannot_be_read_is_named(points, camera, tmp_path, name, text, message):
    path = points()
    (tmp_path / name).unlink()
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=message):
        run_points(path, camera)


def test_an_unknown_method_is_refused(points, camera):
    with pytest.raises(ConfigError, match="--method best: unknown; it must be one of tsai, full"):
        run_points(points(), camera, "best")


def test_a_file_that_cannot_be_written_is_named(points, camera, tmp_path):
    with pytest.raises(ConfigError, match=r"answer\.json: cannot be written"):
        run_points(points(), camera, json_out=str(tmp_path / "none" / "answer.json"))
