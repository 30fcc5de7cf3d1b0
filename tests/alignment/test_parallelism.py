from dataclasses import replace

import numpy as np
import pytest

from service.alignment.parallelism import ArmSlope, SlopeWindow, arm_slope, frame_covariance
from service.vision.measurement import Tubes
from tests.alignment.scenes import (
    CAMERA,
    GUIDE_SIGMA,
    LATTICE,
    geometry_of,
    guide_over,
    measure,
    places_in_view,
    random_pose,
    robust_sd,
    scattered,
    turned,
)

FRAME_NS = 33_333_333


def one_second(seed, *, noise_px=0.1, sway_deg=0.0, guide_sigma=GUIDE_SIGMA, lattice=LATTICE):
    """Error of the averaged slope and its sigma; of one picture's, too. Guide and tube ends are the second's own."""
    rng = np.random.default_rng(seed)
    R, t = random_pose(rng)
    places = places_in_view(CAMERA, lattice, R, t)
    tubes_mm = scattered(rng, lattice, places)
    guide = guide_over(R, t, (R.T @ -t)[:2], np.radians(rng.uniform(-0.3, 0.3, 2)), covariance=np.diag(guide_sigma**2))
    believed = replace(guide, direction=turned(rng.normal(0, guide_sigma[:3])) @ guide.direction)
    window = SlopeWindow(1.0)
    true, single = [], None
    for k in range(30):
        swayed = turned(np.radians(sway_deg) * rng.normal(0, 1, 3)) @ R
        normal = swayed.T @ guide.direction
        true.append(normal[:2] / normal[2])
        m = measure(rng, CAMERA, lattice, swayed, t, places, tubes_mm, noise_px, CAMERA, k * FRAME_NS)
        slope = arm_slope(m, lattice, geometry_of(believed))
        averaged = window.add(m.time_ns, slope)
        single = single or (slope.slope - true[0], slope.covariance)
    mean_error = np.mean([s.slope for _, s in window._kept], axis=0) - np.mean(true, axis=0)
    return mean_error, averaged, single


def components(made):
    """Errors over sigmas of the mean; the sigma of an angle of no direction is that of its components."""
    error = np.degrees(np.concatenate([e for e, _, _ in made]))
    sigma = np.repeat([a.sigma_deg for _, a, _ in made], 2)
    return error, sigma


def test_the_mean_of_a_second_errs_as_its_sigma_says():
    error, sigma = components([one_second(seed) for seed in range(60)])
    assert 0.8 < robust_sd(error / sigma) < 1.2


def test_what_all_frames_share_does_not_average_out():
    made = [one_second(seed) for seed in range(12)]
    naive = np.array([np.sqrt(np.trace(s[1]) / 2) for *_, s in made]) / np.sqrt(30)
    stated = np.radians([a.sigma_deg for _, a, _ in made])
    assert (stated > 3 * naive).all()


def test_noise_does_average_out():
    made = [one_second(seed, noise_px=0.3, guide_sigma=GUIDE_SIGMA / 100) for seed in range(12)]
    single = np.median([np.degrees(np.sqrt(np.trace(s[1]) / 2)) for *_, s in made])
    assert np.median([a.sigma_deg for _, a, _ in made]) < 0.85 * single
    error, sigma = components(made)
    assert robust_sd(error / sigma) < 1.2


def test_an_arm_that_sways_is_not_taken_for_noise_that_averages_out():
    error, sigma = components([one_second(seed, sway_deg=0.3) for seed in range(40)])
    assert robust_sd(error / sigma) < 1.2


def test_no_more_averages_out_than_differs_from_picture_to_picture():
    own, total = np.eye(2) * 1e-6, np.eye(2) * 2e-6
    window = SlopeWindow(1.0)
    for k in range(30):
        averaged = window.add(k * FRAME_NS, ArmSlope(np.zeros(2), total, own))
    assert averaged.sigma_deg == pytest.approx(np.degrees(np.sqrt(2e-6)))


def test_the_window_holds_a_second_and_begins_anew_where_time_runs_back():
    window = SlopeWindow(1.0)
    slope = ArmSlope(np.array([0.01, 0.0]), np.eye(2) * 1e-6, np.zeros((2, 2)))
    for k in range(100):
        averaged = window.add(k * FRAME_NS, slope)
    assert (averaged.frames, averaged.span_s) == (31, pytest.approx(1.0, abs=0.01))
    assert averaged.deg == pytest.approx(np.degrees(np.arctan(0.01)))
    assert window.add(0, slope).frames == 1
    window.clear()
    assert window.add(1, slope).frames == 1


def test_what_is_new_in_a_picture_is_what_differs_between_pictures():
    """Poses of the same tubes scatter by `frame_covariance`, not by the whole covariance."""
    rng = np.random.default_rng(4)
    R, t = random_pose(rng)
    places = places_in_view(CAMERA, LATTICE, R, t)
    tubes_mm = scattered(rng, LATTICE, places)
    made = [measure(rng, CAMERA, LATTICE, R, t, places, tubes_mm, 0.1, CAMERA) for _ in range(200)]
    turns = np.array([0.5 * np.diff(_skew(m.pose.rotation @ R.T))[:, 0] for m in made])
    stated = frame_covariance(made[0].pose, made[0].tubes, LATTICE)
    ratio = np.sqrt(np.diag(stated))[:2] / turns.std(axis=0)[:2]
    assert ((ratio > 0.7) & (ratio < 1.1)).all()
    assert (np.diag(stated)[:2] < 0.8 * np.diag(made[0].pose.covariance)[:2]).all()


def _skew(Q):
    return np.array([[Q[1, 2], Q[2, 1]], [Q[2, 0], Q[0, 2]], [Q[0, 1], Q[1, 0]]])


def test_without_tubes_or_scatter_nothing_is_taken_for_noise():
    R, t = random_pose(np.random.default_rng(1))
    m = measure_simply(R, t)
    assert not frame_covariance(m.pose, Tubes.none(), LATTICE).any()
    assert not frame_covariance(m.pose, m.tubes, replace(LATTICE, scatter_mm=0.0)).any()


def measure_simply(R, t):
    rng = np.random.default_rng(2)
    places = places_in_view(CAMERA, LATTICE, R, t)
    return measure(rng, CAMERA, LATTICE, R, t, places, scattered(rng, LATTICE, places), 0.1, CAMERA)


def test_an_arm_across_the_sheet_has_no_slope():
    R, t = random_pose(np.random.default_rng(1))
    geometry = geometry_of(guide_over(R, t, (0, 0)))
    assert arm_slope(measure_simply(R, t), LATTICE, replace(geometry, arm_normal=R[:, 0])) is None
