import numpy as np
import pytest

from service.vision.lattice import Arrangement
from service.vision.lines import crossings, fit_line, fit_lines
from tests.vision.drawing import lattice_of, sites_of

SIZE = (640, 480)


def even_view(arrangement, count=3):
    """Sites of a sheet seen square on, 80 px a pitch, its (0, 0) at (300, 220)."""
    lattice, site = lattice_of(arrangement), sites_of(count)
    return lattice, site, lattice.sheet_points(*site.T) * 80 / lattice.pitch_mm + (300, 220)


# Step 7


def test_a_line_passes_through_points_that_lie_on_one():
    t = np.array([0.0, 3, 4, 10])
    line = fit_line(np.stack([5 + 2 * t, 7 - t], axis=1), np.full(4, 0.3))
    np.testing.assert_allclose(line.unit, np.array([2, -1]) / np.sqrt(5))
    assert (line.anchor_px - (5, 7)) @ line.normal == pytest.approx(0, abs=1e-12)
    assert line.chi_square == pytest.approx(0, abs=1e-20)


def test_upright_lines_are_lines_like_any_other():
    line = fit_line(np.array([[50.0, 0], [50, 10], [50, 40]]), np.ones(3))
    np.testing.assert_allclose(np.abs(line.unit), (0, 1), atol=1e-12)


def test_a_point_of_large_sigma_hardly_bends_the_line():
    points = np.array([[0.0, 0], [10, 0], [20, 0], [30, 5]])
    line = fit_line(points, np.array([0.1, 0.1, 0.1, 50.0]))
    assert abs(line.unit[1]) < 1e-3
    assert line.chi_square == pytest.approx((5 / 50) ** 2, rel=0.01)


def test_errors_over_sigmas_of_a_line_are_standard_normal():
    rng = np.random.default_rng(8)
    x = np.linspace(0, 500, 7)
    sigma = rng.uniform(0.05, 0.6, 7)
    truth = np.stack([x, 0.4 * x + 30], axis=1)
    normal = np.array([-0.4, 1.0]) / np.hypot(0.4, 1)
    pulls, chi_squares = {60.0: [], 250.0: [], 900.0: []}, []
    for _ in range(1500):
        line = fit_line(truth + rng.normal(0, 1, (7, 2)) * sigma[:, None], sigma)
        chi_squares.append(line.chi_square)
        for at, values in pulls.items():
            point = np.array([at, 0.4 * at + 30])
            values.append((line.anchor_px - point) @ line.normal / np.sqrt(line.variance_px2(point)))
            assert line.normal @ normal > 0.99
    for values in pulls.values():
        assert np.mean(values) == pytest.approx(0, abs=0.1)
        assert np.std(values) == pytest.approx(1, abs=0.07)
    assert np.mean(chi_squares) == pytest.approx(5, rel=0.1)


@pytest.mark.parametrize(
    ("arrangement", "directions"),
    [
        (Arrangement.TRIANGULAR, {0: 0, 60: 60, 120: 120}),
        (Arrangement.ROTATED_TRIANGULAR, {0: 90, 60: 150, 120: 30}),
        (Arrangement.SQUARE, {0: 0, 90: 90}),
        (Arrangement.ROTATED_SQUARE, {0: 45, 90: 135}),
    ],
)
def test_lines_run_in_the_lattices_directions(arrangement, directions):
    lattice, site, points = even_view(arrangement)
    lines = fit_lines(points, np.full(len(points), 0.1), site, lattice)
    assert {line.direction_deg for line in lines} == set(directions)
    for line in lines:
        angle = np.degrees(np.arctan2(line.unit[1], line.unit[0]))
        assert (angle - directions[line.direction_deg] + 90) % 180 - 90 == pytest.approx(0, abs=1e-6)


def test_two_points_are_no_line_and_no_points_no_lines():
    lattice = lattice_of()
    two = np.array([[0, 0], [0, 1]])
    assert fit_lines(np.array([[10.0, 10], [90, 10]]), np.ones(2), two, lattice) == []
    assert fit_lines(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2), int), lattice) == []


def test_points_that_scatter_more_than_they_say_widen_all_lines():
    lattice, site, points = even_view(Arrangement.SQUARE)
    noisy = points + np.random.default_rng(9).normal(0, 0.5, points.shape)
    honest = fit_lines(noisy, np.full(len(points), 0.5), site, lattice)
    boasting = fit_lines(noisy, np.full(len(points), 0.1), site, lattice)
    for a, b in zip(honest, boasting, strict=True):
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=0.35)


# Step 8


@pytest.mark.parametrize("arrangement", Arrangement)
def test_lines_meet_at_the_lattices_places(arrangement):
    lattice, site, points = even_view(arrangement, 2)
    found = crossings(fit_lines(points, np.full(len(points), 0.1), site, lattice), SIZE, lattice)
    truth = lattice.sheet_points(*found.site.T) * 80 / lattice.pitch_mm + (300, 220)
    np.testing.assert_allclose(found.center_px, truth, atol=1e-9)
    assert len(np.unique(found.site, axis=0)) == len(found.site)
    inside = np.all((points >= 0) & (points < SIZE), axis=1)
    assert set(map(tuple, site[inside].tolist())) <= set(map(tuple, found.site.tolist()))


def test_only_places_in_the_picture_are_told():
    lattice, site, points = even_view(Arrangement.TRIANGULAR)
    found = crossings(fit_lines(points, np.full(len(points), 0.1), site, lattice), (320, 240), lattice)
    assert len(found.site)
    assert np.all((found.center_px >= -0.5) & (found.center_px < np.array([319.5, 239.5])))


def test_without_leaves_the_places_that_have_no_centre_of_their_own():
    lattice, site, points = even_view(Arrangement.SQUARE, 2)
    lit = site[:, 1] < 1
    found = crossings(fit_lines(points[lit], np.full(lit.sum(), 0.1), site[lit], lattice), SIZE, lattice)
    dark = found.without(site[lit])
    assert len(dark.site) == len(found.site) - lit.sum()
    assert not set(map(tuple, dark.site.tolist())) & set(map(tuple, site[lit].tolist()))


def test_no_lines_no_intersections():
    found = crossings([], SIZE, lattice_of())
    assert found.site.shape == (0, 2)
    assert found.center_px.shape == (0, 2)
    assert found.covariance_px2.shape == (0, 2, 2)
    assert len(found.without(np.zeros((0, 2), int)).site) == 0


@pytest.mark.parametrize("arrangement", [Arrangement.TRIANGULAR, Arrangement.SQUARE])
def test_the_errors_of_intersections_in_the_dark_are_as_their_covariance_says(arrangement):
    lattice, site, points = even_view(arrangement)
    lit = (site <= 0).any(axis=1)
    rng = np.random.default_rng(10)
    sigma = rng.uniform(0.05, 0.3, len(points))
    squares, farthest = [], []
    for _ in range(200):
        noisy = points + rng.normal(0, 1, points.shape) * sigma[:, None]
        lines = fit_lines(noisy[lit], sigma[lit], site[lit], lattice)
        dark = crossings(lines, SIZE, lattice).without(site[lit])
        truth = lattice.sheet_points(*dark.site.T) * 80 / lattice.pitch_mm + (300, 220)
        error = dark.center_px - truth
        squares.extend(np.einsum("ni,nij,nj->n", error, np.linalg.inv(dark.covariance_px2), error) / 2)
        farthest.append(np.sqrt(np.linalg.eigvalsh(dark.covariance_px2)[:, 1].max()))
    assert np.mean(squares) == pytest.approx(1, abs=0.12)  # a little below: excess scatter widens, none narrows
    assert np.median(farthest) > 0.2
