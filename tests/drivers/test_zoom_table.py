import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.zoom_table import SONY_25X, ZoomTable, focal_prior

RATIOS = {0x0000: 1, 0x1781: 2, 0x2752: 4, 0x362C: 10, 0x3CCB: 18, 0x4000: 25}


@pytest.mark.parametrize(("position", "ratio"), RATIOS.items())
def test_at_the_tables_points_f_is_the_tables_to_one_percent(position, ratio):
    f_mm, sigma_mm = focal_prior(position, 3.3, SONY_25X)
    assert f_mm == pytest.approx(3.3 * ratio)
    assert sigma_mm == pytest.approx(0.01 * f_mm)


@given(st.integers(0, 0x4000 - 1))
def test_f_grows_with_the_position_and_its_sigma_is_one_to_three_percent(position):
    f_mm, sigma_mm = focal_prior(position, 3.3)
    assert focal_prior(position + 1, 3.3)[0] > f_mm
    assert 0.01 * f_mm <= sigma_mm * (1 + 1e-12)
    assert sigma_mm <= 0.03 * f_mm


def test_sigma_covers_what_leaving_out_a_point_of_the_table_shows():
    positions, ratios = SONY_25X._positions, np.exp(SONY_25X._log_ratios)
    for k in range(1, len(positions) - 1):
        rest = [(p, r) for i, (p, r) in enumerate(zip(positions, ratios, strict=True)) if i != k]
        f, sigma = focal_prior(positions[k], 1.0, ZoomTable(rest))
        assert abs(f - ratios[k]) < 2 * sigma, positions[k]


@pytest.mark.parametrize("position", [-1, 0x4001, 0x7AC0, float("nan")])
def test_beyond_the_optical_zoom_there_is_no_f(position):
    with pytest.raises(ValueError, match="digital zoom"):
        focal_prior(position, 3.3)


@pytest.mark.parametrize(
    "points",
    [[], [(0, 1)], [(0, 1), (0, 2)], [(0, 2), (10, 1)], [(10, 1), (0, 2)], [(0, 0), (10, 1)], [(0, -1), (1, 1)]],
)
def test_what_is_no_table_is_refused(points):
    with pytest.raises(ValueError, match="at least two points"):
        ZoomTable(points)
