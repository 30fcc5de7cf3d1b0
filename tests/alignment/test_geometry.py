import math
from dataclasses import replace

import numpy as np
import pytest

from service.alignment.entry import entry, entry_outline
from service.alignment.geometry import GuideAxis, compare, guide_foot, length_sigma, tube_end
from service.vision.measurement import Lock, Measurement, Tubes
from service.vision.projection import project
from tests.alignment.scenes import (
    CAMERA,
    LATTICE,
    geometry_of,
    guide_over,
    make_scene,
    random_pose,
    robust_sd,
    turned,
)
from tests.fakes.results import make_pose

SCENES = 300


@pytest.fixture(scope="module")
def nominal():
    return errors_of([make_scene(seed) for seed in range(SCENES)])


def errors_of(made):
    """Errors and their sigmas: offset (n, 2) mm, slope (n, 2), gap (n,), margin (n,)."""
    errors = {"offset": [], "slope": [], "gap": [], "margin": []}
    sigmas = {key: [] for key in errors}
    for scene, target, lattice in made:
        tube = tube_end(scene.measurement, target, lattice)
        lean = compare(scene.measurement.pose, lattice, scene.geometry, tube)
        truth = scene.truth(target)
        sd = np.sqrt(np.diag(lean.covariance))
        hit = entry(lean, tube, scene.geometry)
        e = np.hypot(*(truth[:2] - truth[4] * truth[2:4]))
        margin = scene.geometry.clearance_mm - e - truth[4] * np.hypot(*truth[2:4])
        for key, error, sigma in (
            ("offset", lean.offset_mm - truth[:2], sd[:2]),
            ("slope", lean.slope - truth[2:4], sd[2:4]),
            ("gap", [lean.gap_mm - truth[4]], sd[4:]),
            ("margin", [hit.margin_mm - margin], [hit.margin_sigma_mm]),
        ):
            errors[key].extend(error)
            sigmas[key].extend(sigma)
    return {k: np.array(v) for k, v in errors.items()}, {k: np.array(v) for k, v in sigmas.items()}


@pytest.mark.parametrize("figure", ["offset", "slope", "gap", "margin"])
def test_errors_are_as_large_as_their_sigmas_say(nominal, figure):
    errors, sigmas = nominal
    assert 0.8 < robust_sd(errors[figure] / sigmas[figure]) < 1.2


def test_the_offset_is_right_to_a_tenth_of_a_millimetre_at_one_metre(nominal):
    errors, _ = nominal
    assert np.median(np.hypot(*errors["offset"].reshape(-1, 2).T)) < 0.1


@pytest.mark.parametrize(
    "change",
    [
        {"focal_sigma_mm": 0.1, "tilt_deg": 4.0},
        {"pitch_sigma_mm": 0.02},
        {"noise_px": 0.2},
        {"unseen": True},
        {"tilt_deg": 35.0, "noise_px": 0.02},
        {"guide_sigma": np.full(6, 1e-6)},
    ],
    ids=["focal length", "pitch", "noise", "covered target", "steep view", "guide known exactly"],
)
def test_whatever_is_uncertain_is_in_the_sigmas(change):
    errors, sigmas = errors_of([make_scene(seed, **change) for seed in range(200)])
    for figure in ("offset", "slope", "gap"):
        assert 0.8 < robust_sd(errors[figure] / sigmas[figure]) < 1.2, figure


def test_each_source_is_told_apart():
    made = {"guide": {}, "pitch": {"pitch_sigma_mm": 0.2}, "tube": {"unseen": True, "guide_sigma": np.full(6, 1e-6)}}
    for source, change in made.items():
        scene, target, lattice = make_scene(3, **change)
        lean = compare(scene.measurement.pose, lattice, scene.geometry, tube_end(scene.measurement, target, lattice))
        shares = {name: np.trace(part[:2, :2]) for name, part in lean.parts.items()}
        assert max(shares, key=shares.get) == source
        assert sum(lean.parts.values()) == pytest.approx(lean.covariance)


def test_derivatives_are_those_of_the_function():
    """Covariances of one small change at a time, against the change itself."""
    rng = np.random.default_rng(5)
    R, t = random_pose(rng)
    lattice = replace(LATTICE, scatter_mm=0.0)
    guide = guide_over(R, t, (4.0, 3.0), (0.02, -0.01))
    pose = replace(make_pose(), rotation=R, translation_mm=t, camera=CAMERA, covariance=np.zeros((6, 6)))
    tube = tube_end(measurement_of(pose), (0, 0), lattice)
    base = compare(pose, lattice, geometry_of(guide), tube)

    def state(lean):
        return np.concatenate([lean.offset_mm, lean.slope, [lean.gap_mm]])

    h = 1e-5
    for k in range(6):
        unit = np.zeros((6, 6))
        unit[k, k] = 1.0
        step = np.eye(3)[k % 3] * h
        for of_pose in (True, False):
            one = replace(pose, covariance=unit) if of_pose else pose
            other = guide if of_pose else replace(guide, covariance=unit)
            predicted = compare(one, lattice, geometry_of(other), tube).covariance
            if of_pose:
                moved = replace(pose, rotation=turned(step) @ R) if k < 3 else replace(pose, translation_mm=t + step)
                changed = compare(moved, lattice, geometry_of(guide), tube)
            else:
                turned_guide = replace(guide, direction=turned(step) @ guide.direction)
                moved = turned_guide if k < 3 else replace(guide, point_mm=guide.point_mm + step)
                changed = compare(pose, lattice, geometry_of(moved), tube)
            by_step = (state(changed) - state(base)) / h
            assert predicted == pytest.approx(np.outer(by_step, by_step), rel=2e-3, abs=1e-6 * (1 + predicted.max()))


def measurement_of(pose):
    return Measurement("progressive", Lock.FULL, None, (), Tubes.none(), pose, 0)


def test_a_held_gap_takes_the_place_of_a_measured_one():
    scene, target, lattice = make_scene(1)
    tube = tube_end(scene.measurement, target, lattice)
    geometry = replace(scene.geometry, gap_mm=30.0, gap_sigma_mm=0.4)
    lean, measured = (compare(scene.measurement.pose, lattice, g, tube) for g in (geometry, scene.geometry))
    assert (lean.gap_mm, lean.covariance[4, 4]) == (30.0, pytest.approx(0.16))
    assert lean.offset_mm == pytest.approx(measured.offset_mm)
    assert not lean.covariance[4, :4].any()


def test_a_guide_that_does_not_point_at_the_sheet_has_no_foot():
    R, t = random_pose(np.random.default_rng(1))
    pose = replace(make_pose(), rotation=R, translation_mm=t)
    for direction in ([0, 0, -1.0], [1.0, 0, 0]):
        away = GuideAxis(np.zeros(3), R @ np.array(direction), np.zeros((6, 6)), at_mouth=True)
        assert guide_foot(pose, away) is None
        assert compare(pose, LATTICE, geometry_of(away), tube_end(measurement_of(pose), (0, 0), LATTICE)) is None


def test_entry_follows_the_rule_for_a_square_nose():
    """e + g tan(theta) <= (ID - OD) / 2; at a gap of 25 mm one degree costs 0.44 mm."""
    R, t = np.eye(3), np.array([0, 0, 1000.0])
    pose = replace(make_pose(), rotation=R, translation_mm=t, covariance=np.zeros((6, 6)))
    tube = tube_end(measurement_of(pose), (0, 0), LATTICE)
    for offset, tilt in ((0.0, 0.0), (0.3, 0.0), (0.0, 1.0), (0.2, 0.7)):
        slope = (math.tan(math.radians(tilt)), 0.0)
        foot = offset + 25.0 * slope[0]  # the offset is the one at the mouth
        lean = compare(pose, LATTICE, geometry_of(guide_over(R, t, (foot, 0.0), slope)), tube)
        hit = entry(lean, tube, geometry_of(guide_over(R, t, (foot, 0.0), slope)))
        assert hit.clearance_mm == pytest.approx(0.584)
        assert hit.margin_mm == pytest.approx(0.584 - offset - 25 * slope[0], abs=1e-9)
        assert hit.semi_axes_mm == pytest.approx((7.874 / math.cos(math.radians(tilt)), 7.874))
        assert hit.center_mm == pytest.approx([foot, 0.0])
        assert lean.tilt_deg == pytest.approx(tilt)
    assert 25 * math.tan(math.radians(1)) == pytest.approx(0.44, abs=0.005)


def test_the_entry_ellipse_is_where_the_probes_surface_meets_the_sheet():
    rng = np.random.default_rng(2)
    R, t = random_pose(rng, tilt_deg=20)
    guide = guide_over(R, t, (10.0, -5.0), (0.15, 0.1))
    pose = replace(make_pose(), rotation=R, translation_mm=t, camera=CAMERA)
    tube = tube_end(measurement_of(pose), (0, 0), LATTICE)
    geometry = geometry_of(guide)
    hit = entry(compare(pose, LATTICE, geometry, tube), tube, geometry)
    outline = entry_outline(pose, hit, 36)
    direction = R.T @ guide.direction
    across = np.linalg.svd(direction[None])[2][1:]
    surface = []
    for a in np.linspace(0, 2 * np.pi, 7200):
        start = R.T @ (guide.point_mm - t) + 7.874 * (math.cos(a) * across[0] + math.sin(a) * across[1])
        surface.append(start - direction * start[2] / direction[2])
    cut = project(CAMERA.vector(), R, t, np.ascontiguousarray(np.array(surface)[:, :2]))
    away = np.linalg.norm(outline[:, None] - cut[None], axis=2).min(axis=1)
    assert away.max() < 0.01


def test_the_length_of_a_short_vector_has_the_sigma_of_its_components():
    covariance = np.diag([0.04, 0.01])
    assert length_sigma(np.array([3.0, 0.0]), covariance) == pytest.approx(0.2)
    assert length_sigma(np.array([0.0, 3.0]), covariance) == pytest.approx(0.1)
    assert length_sigma(np.zeros(2), covariance) == pytest.approx(math.sqrt(0.025))
