import numpy as np
import pytest

from service.vision.centers import CenterMethod, box, box1, center, center_sigma_px, centroid, circle, ellipse
from service.vision.segmentation import Contour, Threshold, binarize, contours, label, smooth, threshold
from tests.vision.drawing import draw_ellipses


def contour_of(drawn, noise=0.0, seed=0, size=(80, 80)):
    picture = draw_ellipses(size, [drawn]) + np.random.default_rng(seed).normal(0, noise, size[::-1])
    grey = smooth(picture.clip(0, 255).astype(np.float32))
    (found,) = contours(*label(binarize(grey, threshold(grey, Threshold.HISTOGRAM))))
    return found


def region_of(rows):
    """Contour of a small region written as text; every pixel of it on the outline."""
    region = np.array([[c == "#" for c in row] for row in rows])
    y, x = np.nonzero(region)
    return Contour(np.stack([x + 10, y + 20], axis=1).astype(float), region, (10, 20))


@pytest.mark.parametrize("method", CenterMethod)
def test_a_perfect_disc_has_one_centre_by_all_five_methods(method):
    np.testing.assert_allclose(center(contour_of((40, 37, 13, 13, 0)), method), (40, 37), atol=1e-6)


@pytest.mark.parametrize("method", CenterMethod)
def test_an_upright_ellipse_as_well(method):
    np.testing.assert_allclose(center(contour_of((40, 37, 18, 13, 0)), method), (40, 37), atol=1e-6)


def test_equation_5_is_the_middle_of_the_bounding_box():
    np.testing.assert_allclose(box(region_of(["##..", ".###", "...#"])), (11.5, 21.0))


def test_equation_6_takes_the_ends_of_the_outermost_rows_and_columns():
    # top row: left end 11; bottom row: right end 12; right column: top 21; left column: bottom 22
    np.testing.assert_allclose(box1(region_of([".##.", "####", "###."])), (11.5, 21.5))
    np.testing.assert_allclose(box1(region_of(["###.", ".##.", ".###"])), (11.5, 21.0))
    np.testing.assert_allclose(box1(region_of(["##..", ".#..", ".###"])), (11.5, 21.0))
    np.testing.assert_allclose(box1(region_of(["..##", "..#.", "###."])), (12.0, 21.0))


def test_box_and_box1_agree_on_a_perfect_circle_as_the_paper_says_and_not_on_a_dented_one():
    whole = contour_of((40, 37, 13, 13, 0))
    np.testing.assert_array_equal(box(whole), box1(whole))
    left_of_the_top = (whole.points_px[:, 1] == whole.points_px[:, 1].min()) & (whole.points_px[:, 0] < 40)
    dented = Contour(whole.points_px[~left_of_the_top], whole.region, whole.corner_px)
    assert abs(box(dented) - box1(dented)).max() == 0.5


def test_equation_7_is_the_centre_of_area():
    np.testing.assert_allclose(centroid(region_of(["##", "#."])), (10 + 1 / 3, 20 + 1 / 3))


def test_circle_and_ellipse_need_no_whole_outline():
    t = np.linspace(0.2, 4.0, 80)
    arc = np.stack([40 + 12 * np.cos(t), 30 + 12 * np.sin(t)], axis=1)
    contour = Contour(arc, np.ones((1, 1), bool), (0, 0))
    np.testing.assert_allclose(circle(contour), (40, 30), atol=1e-8)
    np.testing.assert_allclose(ellipse(contour), (40, 30), atol=1e-6)


def test_methods_that_find_no_centre_say_so_with_nan_and_without_a_warning():
    line = Contour(np.stack([np.arange(9.0), np.arange(9.0)], axis=1), np.ones((9, 9), bool), (0, 0))
    assert np.isnan(circle(line)).all()
    assert np.isnan(ellipse(line)).all()


@pytest.mark.parametrize("method", CenterMethod)
def test_the_stated_sigma_is_that_of_the_errors(method):
    rng = np.random.default_rng(3)
    pulls = []
    for seed in range(150):
        x, y = rng.uniform(38, 42, 2)
        contour = contour_of((x, y, 14.2, 13.4, 20), noise=4, seed=seed)
        pulls.append((center(contour, method) - (x, y)) / center_sigma_px(contour, method))
    assert 0.5 < np.std(pulls) < 1.5
    assert abs(np.mean(pulls)) < 0.35


def test_the_fits_are_better_than_the_boxes():
    rng = np.random.default_rng(4)
    errors = {m: [] for m in CenterMethod}
    for seed in range(80):
        x, y = rng.uniform(38, 42, 2)
        contour = contour_of((x, y, 14.2, 13.4, 20), noise=4, seed=seed)
        for m in CenterMethod:
            errors[m].append(np.hypot(*(center(contour, m) - (x, y))))
    median = {m: np.median(e) for m, e in errors.items()}
    for m in (CenterMethod.CENTROID, CenterMethod.CIRCLE, CenterMethod.ELLIPSE):
        assert median[m] < 0.12 < median[CenterMethod.BOX] < 0.6
