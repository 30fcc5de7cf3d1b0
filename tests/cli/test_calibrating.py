"""Whether the live commands calibrate, and from what."""

from argparse import Namespace

import numpy as np
import pytest

from drivers.errors import ConfigError
from service.cli.calibrating import calibration_sink
from service.cli.parser import parse
from service.vision.camera import Camera, TsaiLens
from tests.vision.installation import LATTICE

KNOWN = Camera((640, 480), (0.005, 0.006), 8.0, TsaiLens(0.001), (320.0, 240.0), 1.01, "mine")
VAGUE = Camera((640, 480), (0.005, 0.006), 8.0, name="mine", parameters=("focal_length_mm",), covariance=np.eye(1))


def asked(out=None, range_mm=None, focal_length_mm=None):
    return Namespace(calibrate=out, range_mm=range_mm, focal_length_mm=focal_length_mm)


def silent(text, level):
    raise AssertionError(f"{level}: {text}")


def test_a_known_camera_is_not_calibrated_unasked():
    assert calibration_sink(KNOWN, LATTICE, asked(), silent) is None


def test_a_camera_that_leaves_something_open_is_calibrated_with_what_is_known_of_it():
    assert calibration_sink(None, LATTICE, asked(), silent)._camera is None
    assert calibration_sink(VAGUE, LATTICE, asked(), silent)._camera is VAGUE


def test_a_file_asked_for_is_found_anew(tmp_path):
    for camera in (KNOWN, VAGUE):
        anew = calibration_sink(camera, LATTICE, asked(tmp_path / "camera.toml"), silent)._camera
        assert (anew.image_size_px, anew.pixel_pitch_mm, anew.name) == ((640, 480), (0.005, 0.006), "mine")
        assert (anew.focal_length_mm, anew.lens, anew.principal_point_px, anew.sx) == (None, None, None, None)
        assert anew.parameters == ()


def test_the_live_commands_take_the_file():
    for line in ("run", "demo", "replay bowl.mkv"):
        assert parse(line.split()).calibrate is None
        assert parse([*line.split(), "--calibrate", "c.toml"]).calibrate.name == "c.toml"


def test_what_is_known_beforehand_is_handed_on(tmp_path):
    args = parse(["run", "--calibrate", str(tmp_path / "c.toml"), "--range-mm", "712±3", "--focal-length-mm", "8"])
    sink = calibration_sink(KNOWN, LATTICE, args, silent)
    assert (sink._range.distance_mm, sink._range.sigma_mm) == (712.0, 3.0)
    assert sink._focal_length_mm == (8.0, pytest.approx(0.24))


@pytest.mark.parametrize("known", [{"range_mm": (712.0, None)}, {"focal_length_mm": (8.0, 0.1)}])
def test_what_is_known_of_a_calibration_that_nobody_asks_for_is_refused(known):
    with pytest.raises(ConfigError, match="--calibrate FILE"):
        calibration_sink(KNOWN, LATTICE, asked(**known), silent)
