import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.vision.segmentation import (
    Ellipse,
    Threshold,
    aspect_px,
    binarize,
    circular,
    contours,
    fit_ellipse,
    label,
    semi_axes,
    smooth,
    threshold,
)
from tests.vision.drawing import BRIGHT, DARK, draw_ellipses

DISC = (40.3, 30.8, 12.0, 12.0, 0.0)


def found_in(picture, by=Threshold.HISTOGRAM):
    grey = smooth(picture.astype(np.uint8))
    return contours(*label(binarize(grey, threshold(grey, by))))


def on_ellipse(x, y, a, b, angle_deg, count=60):
    t, turn = np.linspace(0, 2 * np.pi, count, endpoint=False), np.radians(angle_deg)
    own = np.stack([a * np.cos(t), b * np.sin(t)], axis=1)
    return own @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + [x, y]


# Step 1


def test_smoothing_takes_out_a_speck_and_keeps_an_even_picture_even():
    picture = np.full((20, 30), 50, np.uint8)
    picture[10, 15] = 255
    np.testing.assert_allclose(smooth(picture), 50, atol=1e-4)


def test_smoothing_lowers_noise_and_leaves_the_picture_it_was_given():
    picture = np.random.default_rng(1).normal(100, 10, (80, 80)).astype(np.uint8)
    before = picture.copy()
    assert smooth(picture).std() < picture.std() / 3
    np.testing.assert_array_equal(picture, before)


def test_sixteen_bit_pictures_keep_their_depth():
    picture = np.full((20, 20), 40_000, np.uint16)
    assert smooth(picture).max() == pytest.approx(40_000)


# Step 2


@pytest.mark.parametrize("by", Threshold)
def test_every_threshold_parts_dark_discs_from_an_evenly_lit_ground(by):
    picture = draw_ellipses((320, 240), [(x, y, 12, 12, 0) for x in range(20, 320, 40) for y in range(20, 240, 40)])
    level = threshold(smooth(picture.astype(np.float32)), by)
    assert np.all((level > DARK + 10) & (level < BRIGHT - 10))


def test_the_histogram_threshold_stands_in_the_middle_of_an_empty_valley():
    picture = np.repeat(np.float32([[20, 120]]), 50, axis=0).repeat(20, axis=1)
    assert threshold(picture, Threshold.HISTOGRAM).item() == pytest.approx(70, abs=1)


def test_only_the_projection_follows_light_that_falls_off():
    discs = [(x, y, 10, 10, 0) for x in range(20, 400, 40) for y in range(20, 160, 40)]
    light = np.linspace(1.0, 0.2, 400)
    picture = (draw_ellipses((400, 160), discs) * light).clip(0, 255)
    assert len(found_in(picture, Threshold.PROJECTION)) == len(discs)
    assert len(found_in(picture, Threshold.HISTOGRAM)) < len(discs)


@pytest.mark.parametrize("by", Threshold)
@pytest.mark.parametrize("grey", [0, 77, 255])
def test_a_flat_picture_has_a_finite_threshold_and_no_contours(by, grey):
    picture = np.full((60, 80), grey, np.uint8)
    assert np.isfinite(threshold(smooth(picture), by)).all()
    assert found_in(picture, by) == []


# Step 3


def test_labels_number_the_regions_and_the_table_gives_their_boxes():
    dark = np.zeros((10, 12), bool)
    dark[1:4, 2:5] = dark[6:9, 7:11] = True
    labels, table = label(dark)
    assert labels.max() == 2
    assert [tuple(row) for row in table[1:]] == [(2, 1, 3, 3, 9), (7, 6, 4, 3, 12)]


def test_regions_that_touch_at_a_corner_only_are_two():
    dark = np.zeros((6, 6), bool)
    dark[1:3, 1:3] = dark[3:5, 3:5] = True
    assert label(dark)[0].max() == 2


# Step 4


def test_a_contour_is_the_regions_own_outermost_pixels():
    labels = np.zeros((30, 30), np.int32)
    labels[10:20, 5:15] = 1
    (contour,) = contours(labels, np.array([[0, 0, 30, 30, 800], [5, 10, 10, 10, 100]], np.int32))
    assert len(contour.points_px) == 36
    assert contour.points_px.min(axis=0).tolist() == [5, 10]
    assert contour.points_px.max(axis=0).tolist() == [14, 19]


def test_a_hole_in_a_region_is_filled_and_gives_no_contour():
    labels = np.zeros((30, 30), np.int32)
    labels[10:20, 5:15] = 1
    labels[14:16, 9:11] = 0
    (contour,) = contours(labels, np.array([[0, 0, 30, 30, 804], [5, 10, 10, 10, 96]], np.int32))
    assert len(contour.points_px) == 36
    assert contour.region.all()


@pytest.mark.parametrize("center", [(5, 30), (75, 30), (40, 5), (40, 55)])
def test_discs_cut_by_the_border_are_left_out(center):
    picture = draw_ellipses((80, 60), [(*center, 12, 12, 0)])
    assert found_in(picture) == []


def test_specks_and_a_dark_half_of_the_picture_are_no_contours():
    picture = draw_ellipses((160, 60), [DISC, (70, 30, 2, 2, 0)])
    picture[2:58, 85:158] = DARK
    assert len(found_in(picture)) == 1


# Step 5


def test_the_aspect_of_a_circle_is_zero_and_grows_with_the_ellipse():
    assert aspect_px(Ellipse((0, 0), (12.0, 12.0), 0, 0)) == 0
    assert aspect_px(Ellipse((0, 0), (15.0, 12.0), 0, 0)) == aspect_px(Ellipse((0, 0), (12.0, 15.0), 0, 0)) == 6


@pytest.mark.parametrize(
    ("ellipse", "kept"),
    [((40, 30, 14, 14, 0), 1), ((40, 30, 16, 12, 30), 1), ((40, 30, 22, 8, 0), 0), ((40, 30, 22, 8, 45), 0)],
)
def test_the_aspect_filter_keeps_circles_seen_at_a_slant_and_drops_what_is_longer(ellipse, kept):
    assert len(circular(found_in(draw_ellipses((80, 60), [ellipse])))) == kept


def test_the_aspect_filter_drops_what_is_as_wide_as_high_but_not_round():
    picture = np.full((120, 120), BRIGHT)
    picture[20:60, 20:60] = DARK
    picture[20:40, 40:60] = BRIGHT
    assert len(found_in(picture)) == 1
    assert circular(found_in(picture)) == []


# Equations 8 to 11


@given(a=st.floats(3, 60), b=st.floats(3, 60))
def test_equation_11_gives_the_semi_axes_of_an_ellipse_about_its_centre(a, b):
    assert semi_axes(on_ellipse(0, 0, a, b, 0)) == pytest.approx((a, b), rel=1e-6)


def test_the_semi_axes_solve_equation_11_as_printed():
    points = on_ellipse(0, 0, 14, 11, 0) + np.random.default_rng(2).normal(0, 0.3, (60, 2))
    (x2, y2), (x4, y4) = (points**2).sum(axis=0), (points**4).sum(axis=0)
    xy = (points**2).prod(axis=1).sum()
    a, b = semi_axes(points)
    assert x2 * a**2 * b**2 - xy * a**2 - x4 * b**2 == pytest.approx(0, abs=1e-6 * x4 * b**2)
    assert y2 * a**2 * b**2 - y4 * a**2 - xy * b**2 == pytest.approx(0, abs=1e-6 * y4 * a**2)


def test_equation_11_has_no_answer_for_points_on_a_line():
    assert semi_axes(np.stack([np.arange(9.0), np.arange(9.0)], axis=1)) is None
    assert semi_axes(np.zeros((8, 2))) is None


@given(
    x=st.floats(-500, 2000), y=st.floats(-500, 2000), a=st.floats(4, 60), flat=st.floats(0.5, 0.95),
    angle=st.floats(-80, 80),
)  # fmt: skip
def test_a_conic_through_an_ellipse_has_its_centre_axes_and_direction(x, y, a, flat, angle):
    fitted = fit_ellipse(on_ellipse(x, y, a, a * flat, angle))
    assert fitted.center_px == pytest.approx((x, y), abs=1e-6 * (1 + abs(x) + abs(y)))
    assert sorted(fitted.semi_axes_px) == pytest.approx([a * flat, a], rel=1e-6)
    long_axis = fitted.angle_deg + (90 if fitted.semi_axes_px[0] < fitted.semi_axes_px[1] else 0)
    assert (long_axis - angle + 90) % 180 - 90 == pytest.approx(0, abs=1e-3)
    assert fitted.residual_px == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 2)),
        np.zeros((12, 2)),
        on_ellipse(0, 0, 5, 5, 0, count=5),
        np.stack([np.arange(20.0), np.arange(20.0)], axis=1),
        np.stack([np.arange(-10.0, 10), np.arange(-10.0, 10) ** 2], axis=1),
    ],
    ids=["none", "one place", "too few", "line", "parabola"],
)
def test_points_that_lie_on_no_ellipse_give_none(points):
    assert fit_ellipse(points) is None
