"""Errors against truth, over the sigmas that are told with them: one, or nearly so.

Each figure is the robust standard deviation of errors over sigmas. Its own uncertainty comes from drawing pictures anew
from those that were measured (bootstrap), as the errors within one picture have much in common.
"""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import HARD, NOMINAL
from service.vision.camera import TsaiLens
from service.vision.measurement import Lock
from tests.scenes.rendered import errors_of, looking, optics_of, robust_sd, view

HONEST = 0.8, 1.2
DULL = 0.25
"""Rendered bore walls are dull: of what real light does to all edges in common, and sigmas allow for, little is left.
So sigmas may be larger than errors where noise is not what counts."""
PICTURES = 16
LIT = replace(NOMINAL, hose=False, lane_rows=0, wall=0.05)
GRADES = {
    "nominal": LIT,
    "hard": replace(HARD, hose=False, lane_rows=0, wall=0.05),
    "dark": replace(LIT, ambient=0.0, spot=0.2),
}


def one_picture(look, seed):
    """Errors over sigmas of a picture from any side: measured tubes, inferred tubes, distance, tilt, lateral."""
    rng = np.random.default_rng([seed, 7])
    pose = looking(rng.uniform(2, 15), rng.uniform(0, 360), rng.uniform(0, 60), at_mm=rng.uniform(-30, 30, 2))
    tubes, pitch_px = ("system80", "model-f")[seed % 2], rng.uniform(22, 36)
    seen = view(tubes, look, pose=pose, seed=seed, pitch_px=pitch_px, bend=rng.uniform(0, 0.02))
    m = seen.measure()
    assert m.lock is not Lock.NONE, m.reason
    e = errors_of(seen, m)
    return {
        "measured": e.measured_px / e.measured_sigma_px[:, None],
        "inferred": e.inferred_px / e.inferred_sigma_px[:, None],
        "distance": np.array([e.distance_mm[0] / e.distance_mm[1]]),
        "tilt": np.array([e.tilt_deg[0] / e.tilt_deg[1]]),
        "lateral": e.lateral_mm[0] / e.lateral_mm[1],
    }


@pytest.fixture(scope="module")
def pictures():
    return {name: [one_picture(look, seed) for seed in range(PICTURES)] for name, look in GRADES.items()}


def margin(values):
    """The robust standard deviation of (error over sigma) by picture, lowest and highest that chance explains."""
    rng = np.random.default_rng(0)
    drawn = [robust_sd([values[k] for k in rng.integers(0, len(values), len(values))]) for _ in range(300)]
    return np.percentile(drawn, [1, 99])


def assert_honest(values, least=HONEST[0]):
    low, high = margin(values)
    assert low < HONEST[1], f"too sure: {robust_sd(values):.2f}, {low:.2f} at the least"
    assert high > least, f"too unsure: {robust_sd(values):.2f}, {high:.2f} at the most"


@pytest.mark.parametrize("what", ["measured", "inferred"])
@pytest.mark.parametrize("grade", GRADES)
def test_sigmas_of_tubes_are_honest_in_every_light(pictures, grade, what):
    values = [p[what] for p in pictures[grade] if len(p[what])]
    assert sum(len(v) for v in values) > 20
    assert_honest(values, DULL)


@pytest.mark.parametrize(("what", "least"), [("distance", HONEST[0]), ("tilt", HONEST[0]), ("lateral", DULL)])
def test_sigmas_of_the_pose_are_honest(pictures, what, least):
    assert_honest([p[what] for grade in pictures.values() for p in grade], least)


@pytest.mark.parametrize("grade", GRADES)
def test_no_pose_is_off_by_more_than_its_sigma_can_explain(pictures, grade):
    worst = {what: max(np.abs(p[what]).max() for p in pictures[grade]) for what in ("distance", "tilt", "lateral")}
    assert max(worst.values()) < 6.0, worst


@pytest.mark.xfail(strict=False, reason="bore walls as bright as these shift distances by 4 to 6 of their sigmas")
def test_brightly_lit_bore_walls_are_in_the_sigmas():
    each = [one_picture(replace(LIT, wall=0.2), seed) for seed in range(8)]
    for what in ("measured", "distance", "tilt"):
        assert_honest([p[what] for p in each])


def drawn(what, rng, seen):
    """Camera and lattice as they are told: off by a draw of their own sigma."""
    camera, lattice = seen.camera, seen.lattice
    if what == "focal length":
        sigma = 0.01 * camera.focal_length_mm
        f = camera.focal_length_mm + rng.normal(0, sigma)
        told = replace(camera, focal_length_mm=f, parameters=("focal_length_mm",), covariance=np.array([[sigma**2]]))
        return told, lattice
    if what == "principal point":
        point = tuple(np.array(camera.principal_point_px) + rng.normal(0, 5.0, 2))
        return replace(
            camera, principal_point_px=point, parameters=("cx_px", "cy_px"), covariance=np.diag([25.0, 25.0])
        ), lattice
    if what == "lens":
        bend = camera.lens.kappa1_per_mm2
        told = TsaiLens(bend + rng.normal(0, 0.5 * bend))
        covariance = np.array([[(0.5 * bend) ** 2]])
        return replace(camera, lens=told, parameters=("kappa1_per_mm2",), covariance=covariance), lattice
    sigma = 0.005 * lattice.pitch_mm
    return camera, replace(lattice, pitch_mm=lattice.pitch_mm + rng.normal(0, sigma), pitch_sigma_mm=sigma)


@pytest.mark.parametrize("what", ["focal length", "principal point", "lens", "pitch"])
def test_what_is_not_known_of_camera_and_pitch_is_in_the_sigmas(what):
    """One picture, measured with many cameras (or lattices), drawn as their own sigmas would have them."""
    rng = np.random.default_rng(11)
    seen = view(look=LIT, optics=optics_of(bend=0.02), pose=looking(9.0))
    exact = seen.measure().pose
    distance, tilt, poses = [], [], []
    for _ in range(12):
        m = seen.measure(*drawn(what, rng, seen))
        assert m.lock is not Lock.NONE
        distance.append((m.pose.distance_mm - exact.distance_mm) / m.pose.sigma.distance_mm)
        tilt.append((m.pose.tilt_deg - exact.tilt_deg) / m.pose.sigma.tilt_deg)
        poses.append(m.pose)
    assert max(np.abs(distance).max(), np.abs(tilt).max()) < 4.0
    sigma_mm, sigma_deg = np.median([[p.sigma.distance_mm, p.sigma.tilt_deg] for p in poses], axis=0)
    assert sigma_mm > 0.6 * np.std([p.distance_mm for p in poses])
    assert sigma_deg > 0.6 * np.std([p.tilt_deg for p in poses])
    assert sigma_mm > 0.95 * exact.sigma.distance_mm
    assert sigma_deg > 0.95 * exact.sigma.tilt_deg
    if what == "pitch":
        assert sigma_mm == pytest.approx(0.005 * exact.distance_mm, rel=0.1)
    if what == "focal length":  # the picture itself knows it a little better than was told; light adds some
        assert 0.3 < sigma_mm / (0.01 * exact.distance_mm) < 1.2


def test_a_value_told_without_a_sigma_counts_as_exact():
    seen = view(look=LIT)
    camera = seen.camera
    variance = np.array([[(0.01 * camera.focal_length_mm) ** 2]])
    exact = seen.measure(camera).pose.sigma
    loose = seen.measure(replace(camera, parameters=("focal_length_mm",), covariance=variance)).pose.sigma
    assert exact.focal_length_mm == 0.0
    assert loose.focal_length_mm > 0.0
    assert loose.distance_mm > 10 * exact.distance_mm
