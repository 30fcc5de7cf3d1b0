import math

import pytest

from service.sinks.viewer_status import reading, status_text, why
from service.vision.measurement import Doubt, Lock
from tests.fakes.drawn import made_up


@pytest.mark.parametrize(
    ("value", "sigma", "said"),
    [
        (1265.3217, 0.314, "1265.32 ± 0.31 mm"),
        (1265.3217, 0.0951, "1265.322 ± 0.095 mm"),
        (1265.3217, 27.3, "1265 ± 27 mm"),
        (1265.3217, 314.2, "1265 ± 314 mm"),
        (2.5, 1e-9, "2.5000 ± 0.0000 mm"),
        (2.5, 0.0, "2.50 mm, sigma 0"),
        (2.5, math.inf, "2.50 mm, sigma unknown"),
        (2.5, math.nan, "2.50 mm, sigma unknown"),
    ],
)
def test_a_reading_shows_the_digits_that_its_sigma_leaves(value, sigma, said):
    assert reading(value, sigma, "mm") == said


def test_the_readings_of_a_full_lock():
    text = status_text(made_up(7)[1], "REPLAY of x.mp4").split("\n\n")
    assert text[:4] == ["**REPLAY of x.mp4**", "# Lock full", "# 400.70 ± 0.25 mm distance", "# 0.000 ± 0.080 deg tilt"]
    assert text[4] == "5 measured, 3 predicted; among them 1 plugged, 1 absent"
    assert text[5] == "fit 0.11 px rms; sideways ± 0.10 mm; frame 7; measured in 6 ms"


def test_without_a_lock_there_are_reasons_and_no_numbers():
    text = status_text(made_up(lock=Lock.NONE, reason="lamp off")[1])
    assert "# Lock none: lamp off" in text
    assert "mm" not in text


def test_the_field_is_named():
    assert "frame 0, top field;" in status_text(made_up(field="top")[1])


def test_why_a_lock_is_not_full():
    assert why(made_up()[1].measurement) is None
    assert why(made_up(lock=Lock.PARTIAL, doubt=(Doubt.INDEX, Doubt.SCALE))[1].measurement) == "index, scale in doubt"
    assert why(made_up(lock=Lock.NONE, reason="dark")[1].measurement) == "dark"
