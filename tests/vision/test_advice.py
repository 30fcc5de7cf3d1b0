"""What a calibration lacks, in words; and that following the advice helps."""

import numpy as np
import pytest

from service.vision.advice import missing
from service.vision.calibration_report import brief, calibration_dict, calibration_lines
from service.vision.selfcalibration import calibrate
from tests.vision.installation import LATTICE, UNKNOWN, Sheet, installation, seen_from

MOVED = {
    "vertical, right side nearer": (0.0, 10.0),
    "vertical, left side nearer": (0.0, -10.0),
    "horizontal, top nearer": (10.0, 0.0),
    "horizontal, bottom nearer": (-10.0, 0.0),
}


def calibrated(*tilts):
    sheet = Sheet(np.random.default_rng(1))
    return calibrate([sheet.picture(seen_from(*t)) for t in tilts], UNKNOWN, LATTICE)


@pytest.mark.parametrize("words", MOVED)
def test_the_words_name_the_side_that_comes_nearer(words):
    rotation, translation = seen_from(*MOVED[words])
    sides = {"right": (1, 0), "left": (-1, 0), "bottom": (0, 1), "top": (0, -1)}
    rays = {name: np.array([0.2 * x, 0.2 * y, 1.0]) for name, (x, y) in sides.items()}
    normal = rotation[:, 2]
    depth = {name: float(normal @ translation / (normal @ ray)) for name, ray in rays.items()}
    assert min(depth, key=depth.get) in words


def test_one_frontal_picture_asks_for_a_tilt():
    lacking = missing(calibrated((2.0, 0.0)), LATTICE)
    assert lacking
    assert lacking.what[0].startswith("focal length (to ")
    assert lacking.remedy.startswith("tilt the camera 10 deg about the picture's ")


@pytest.mark.parametrize(("tilt", "other"), [((10.0, 0.0), "vertical"), ((0.0, 10.0), "horizontal")])
def test_after_a_tilt_about_one_axis_the_other_is_asked_for(tilt, other):
    assert f"the picture's {other}" in missing(calibrated(tilt), LATTICE).remedy


def test_following_the_advice_leads_to_knowing_all():
    tilts = [(1.0, 0.0)]
    for _ in range(6):
        lacking = missing(calibrated(*tilts), LATTICE)
        if not lacking:
            break
        tilts.append(next(move for words, move in MOVED.items() if lacking.remedy.endswith(words)))
    assert not missing(calibrated(*tilts), LATTICE)
    assert len(tilts) <= 5


def test_the_report_says_what_is_not_known():
    calibration = calibrated((2.0, 0.0))
    lines = calibration_lines(calibration, LATTICE)
    assert lines[0].startswith("focal length      NOT KNOWN: ")
    assert lines[-1].startswith("not known well enough: focal length (to ")
    assert "NOT KNOWN" in brief(calibration, LATTICE)
    told = calibration_dict(calibration, LATTICE)
    assert told["sigma"]["focal_length_mm"] > 0.05 * told["focal_length_mm"]
    assert told["missing"]
    assert told["remedy"].startswith("tilt")
    assert told["tz_over_f_sigma"] < 3e-3 * told["tz_over_f"]


def test_the_report_says_when_all_is_known():
    calibration = calibrate(installation(3, 24), UNKNOWN, LATTICE)
    assert calibration_lines(calibration, LATTICE)[-1] == "all is known"
    told = calibration_dict(calibration, LATTICE)
    assert (told["missing"], told["remedy"], told["frames"]) == ([], None, 24)
    assert brief(calibration, LATTICE).startswith("f = 6.")
