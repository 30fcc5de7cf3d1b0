"""`bowlsight calibrate PATH...` on rendered pictures, and what it refuses."""

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from drivers.scene import NOMINAL
from service.cli import calibrate_pictures as command
from service.cli import main
from service.config.cameras import read_camera, write_camera
from tests.scenes.rendered import camera_of, looking, sheet_of, view

LOOK = replace(NOMINAL, hose=False, lane_rows=0, scatter_mm=0.06)
TILTS = [(2.0, 0.0), *((9.0, 45.0 * i) for i in range(4)), *((14.0, 45.0 * i + 180.0) for i in range(4))]


def pictures(folder, tilts):
    """Render pictures of one sheet; gives the truth of the last."""
    folder.mkdir()
    sheet, v = None, None
    for i, (tilt, azimuth) in enumerate(tilts):
        pose = looking(tilt, azimuth, at_mm=(4.0 * i, 3.0))
        v = view("system80", LOOK, pose=pose, seed=i, sheet=sheet or sheet_of(view("system80").sheet.lattice, LOOK))
        sheet = v.sheet
        assert cv2.imwrite(str(folder / f"{i:02d}.png"), v.image)
    return v


@pytest.fixture(scope="module")
def installation(tmp_path_factory):
    folder = tmp_path_factory.mktemp("installation") / "pictures"
    v = pictures(folder, TILTS)
    known = folder.parent / "known.toml"
    (w, h), (dx, dy) = (v.optics.width_px, v.optics.height_px), v.optics.pixel_pitch_mm
    known.write_text(f"image_size_px = [{w}, {h}]\npixel_pitch_mm = [{dx}, {dy}]\n")
    return folder, known, v.optics


@pytest.fixture
def calibrate(installation, tmp_path, capsys):
    """Run the command on the installation or some of it; gives status, what it said and the file it wrote."""
    folder, known, _ = installation
    out = tmp_path / "camera.toml"

    def run(*more, paths=(folder,), camera=known):
        arguments = ["calibrate", *paths, "--generator", "system80", "--out", out, "--camera", camera, *more]
        status = main([str(a) for a in arguments])
        return status, *capsys.readouterr(), out

    return run


def test_pictures_of_several_tilts_give_a_camera_file_with_its_covariance(calibrate, installation):
    status, said, _, out = calibrate()
    assert status == 0
    optics, camera = installation[2], read_camera(out)
    error = camera.focal_length_mm - optics.focal_length_mm
    assert abs(error) < 4 * camera.sigma("focal_length_mm") < 0.004 * optics.focal_length_mm
    assert {"focal_length_mm", "kappa1_per_mm2", "cx_px", "cy_px", "sx"} == set(camera.parameters)
    assert np.linalg.eigvalsh(camera.covariance).min() > 0
    text = out.read_text()
    assert f"frames = {len(TILTS)}" in text
    assert re.search(r'calibrated_utc = "20\d\d-', text)
    assert re.search(r"reprojection_error_px = 0\.\d", text)
    assert said.startswith(f"{len(TILTS)} of {len(TILTS)} pictures kept\nfocal length")
    assert said.endswith(f"{out}: written\n")


def test_what_was_written_serves_as_a_camera_and_as_a_prior(calibrate, installation, tmp_path):
    first = read_camera(calibrate()[3])
    better = tmp_path / "first.toml"
    write_camera(better, first)
    status, _, _, out = calibrate(camera=better, paths=[installation[0] / "00.png"])
    assert status == 0
    camera = read_camera(out)
    assert camera.sigma("focal_length_mm") <= first.sigma("focal_length_mm") * 1.001
    assert camera.focal_length_mm == pytest.approx(first.focal_length_mm, abs=2 * first.sigma("focal_length_mm"))


def test_one_nearly_frontal_picture_is_not_made_more_of_than_it_is(calibrate, installation):
    status, said, _, out = calibrate(paths=[installation[0] / "00.png"])
    assert status == 0
    camera = read_camera(out)
    assert camera.sigma("focal_length_mm") > 0.05 * camera.focal_length_mm
    assert "NOT KNOWN" in said
    assert "tilt the camera 10 deg about the picture's" in said


@pytest.mark.parametrize("mark", ["±", "+-", "+/-"])
def test_a_measured_range_tells_the_focal_length(calibrate, installation, mark):
    rotation, translation = looking(*TILTS[0], at_mm=(0.0, 3.0))
    distance = float(rotation[:, 2] @ translation)
    status, said, _, out = calibrate("--range-mm", f"{distance:.1f}{mark}1.5", paths=[installation[0] / "00.png"])
    assert status == 0
    camera = read_camera(out)
    f = installation[2].focal_length_mm
    assert camera.sigma("focal_length_mm") < 0.004 * f
    assert abs(camera.focal_length_mm - f) < 4 * camera.sigma("focal_length_mm")
    assert "NOT KNOWN" not in said


def test_a_focal_length_that_is_told_holds_as_well_as_it_is_told(calibrate, installation):
    _, _, _, out = calibrate("--focal-length-mm", "9.5±0.2", paths=[installation[0] / "00.png"])
    assert read_camera(out).focal_length_mm == pytest.approx(9.5, abs=0.3)
    assert read_camera(out).sigma("focal_length_mm") == pytest.approx(0.2, rel=0.2)
    _, _, _, out = calibrate("--focal-length-mm", "9.5", paths=[installation[0] / "00.png"])
    assert read_camera(out).sigma("focal_length_mm") == pytest.approx(0.03 * 9.5, rel=0.3)


def test_the_figures_as_json_stand_alone(calibrate, installation):
    status, said, _, out = calibrate("--json", "-")
    told = json.loads(said)
    assert status == 0
    assert told["frames"] == len(TILTS)
    assert told["focal_length_mm"] == read_camera(out).focal_length_mm
    assert told["sigma"]["focal_length_mm"] == read_camera(out).sigma("focal_length_mm")


def test_without_a_camera_file_the_sensor_is_assumed_and_that_is_said(installation, tmp_path, capsys):
    out = tmp_path / "camera.toml"
    folder = str(installation[0])
    assert main(["calibrate", folder, "--generator", "system80", "--out", str(out), "--json", str(tmp_path / "j")]) == 0
    assert "um assumed" in capsys.readouterr().err
    assert "sx" in read_camera(out).parameters
    assert json.loads((tmp_path / "j").read_text())["frames"] == len(TILTS)


def test_pictures_without_tubes_write_nothing(calibrate, tmp_path):
    black = tmp_path / "black.png"
    assert cv2.imwrite(str(black), np.zeros((240, 320), np.uint8))
    status, _, said, out = calibrate(paths=[black])
    assert status == 1
    assert "1 picture left out: no lock" in said
    assert said.splitlines()[-1] == f"bowlsight: {black}: no picture shows 12 tubes; nothing is written"
    assert not out.exists()


def test_a_camera_of_which_nothing_is_open_is_refused(calibrate, installation, tmp_path):
    complete = tmp_path / "complete.toml"
    write_camera(complete, camera_of(installation[2]))
    status, _, said, out = calibrate(camera=complete)
    assert status == 2
    assert "gives all values without a sigma" in said
    assert not out.exists()


def test_a_camera_file_of_other_pictures_is_refused(calibrate, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text("image_size_px = [640, 480]\npixel_pitch_mm = [0.005, 0.005]\n")
    status, _, said, _ = calibrate(camera=other)
    assert status == 2
    assert "320x240 px, but camera 'other' has image_size_px = [640, 480]" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("", "give PATH..., pictures of the tubesheet from several tilts, or --points FILE"),
        ("PATH --out OUT", "calibrate: give --generator NAME with"),
        ("PATH --generator system80", "calibrate: give --out FILE with"),
        ("PATH --generator system80 --out PATH", "is a source, or another output, already"),
        ("PATH --generator system80 --out DIR", "cannot be written there; give a file in a folder that exists"),
        ("PATH --generator system80 --out DIR/none/c.toml", "cannot be written there"),
        ("PATH --generator system80 --out OUT --json OUT", "another output, already"),
        ("PATH --generator system80 --out OUT --method full", "--method full: is for --points; leave it out"),
        ("PATH --points p.dat", "--points from points; give one of the two"),
        ("--points p.dat --out OUT", "--out: is for pictures, not for --points"),
        ("--points p.dat --range-mm 900", "--range-mm: is for pictures, not for --points"),
        ("--points p.dat", "give --camera FILE with the picture's size"),
        ("PATH --generator system80 --out OUT --range-mm far", "'far' is no number"),
        ("PATH --generator system80 --out OUT --range-mm 900±0", "'0' must be a number above 0"),
        ("PATH --generator system80 --out OUT --range-mm 900±", "'' is no number"),
        ("PATH --generator system80 --out OUT --focal-length-mm -3", "'-3' must be a number above 0"),
        ("PATH --generator no-such --out OUT", "no-such"),
        ("DIR/none.mkv --generator system80 --out OUT", "none.mkv"),
    ],
)
def test_wrong_use_is_one_clear_line(installation, tmp_path, capsys, arguments, words):
    path, out = str(installation[0] / "00.png"), str(tmp_path / "out.toml")
    given = [a.replace("PATH", path).replace("OUT", out).replace("DIR", str(tmp_path)) for a in arguments.split()]
    assert main(["calibrate", *given]) == 2
    said = capsys.readouterr().err.splitlines()
    assert words in said[-1]
    assert all(line.startswith("bowlsight: ") for line in said)
    assert not (tmp_path / "out.toml").exists()


def test_help_has_an_example(capsys):
    assert main(["calibrate", "--help"]) == 0
    assert "bowlsight calibrate installation.mkv --generator model-f --out camera.toml" in capsys.readouterr().out


def test_it_measures_again_with_the_camera_that_it_found_until_that_stands_still(calibrate, installation, monkeypatch):
    cameras, measurer = [], command.Measurer

    def noted(camera, *more, **settings):
        cameras.append(camera)
        return measurer(camera, *more, **settings)

    monkeypatch.setattr(command, "Measurer", noted)
    out = calibrate()[3]
    assert cameras[0].focal_length_mm is None
    assert 2 <= len(cameras) <= command.MOST_TURNS
    assert cameras[-1].focal_length_mm == pytest.approx(read_camera(out).focal_length_mm, rel=1e-3)
