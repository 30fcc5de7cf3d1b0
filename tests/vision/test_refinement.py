"""How well tubes are measured: against the centres of the rims that were drawn."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from drivers.scene import CLEAN, NOMINAL
from service.vision import refinement
from service.vision.approach import approach
from service.vision.edges import start_profile
from service.vision.measurement import Lock, Origin
from service.vision.pose import NO_PRIOR
from service.vision.projection import project
from service.vision.refinement import refine
from service.vision.rims import measure_rims
from service.vision.shapes import shapes_of
from service.vision.stopwatch import Stopwatch
from tests.scenes.rendered import PLAIN, errors_of, looking, view

EVEN = replace(PLAIN, wall=0.0, read_noise=0.5)
"""Even light, dark bores, next to no noise."""
REAL = replace(NOMINAL, hose=False, lane_rows=0, wall=0.05)


def rms_px(errors):
    return float(np.sqrt(np.mean(errors.measured_px**2)))


def scored(seen, **told):
    m = seen.measure(**told)
    assert m.lock is not Lock.NONE, m.reason
    return m, errors_of(seen, m)


@pytest.mark.parametrize("tilt_deg", [0, 20, 45])
@pytest.mark.parametrize("pitch_px", [28.0, 40.0])
def test_the_circles_centre_is_told_not_its_ellipses(tilt_deg, pitch_px):
    """Aslant the centre of the ellipse is off by a third of a pixel; what is told must not be."""
    seen = view(look=EVEN, pose=looking(tilt_deg, distance_mm=300.0), pitch_px=pitch_px, distance_mm=300.0)
    _, e = scored(seen)
    assert rms_px(e) < 0.05
    assert (e.missed, e.false) == (0, 0)
    assert abs(e.tilt_deg[0]) < 0.05
    assert abs(e.distance_mm[0]) < 0.15


@pytest.mark.parametrize("opencv", [False, True])
def test_nor_does_a_bent_picture_shift_it(opencv):
    _, e = scored(view(look=EVEN, bend=0.15, opencv=opencv))
    assert rms_px(e) < 0.03


@pytest.mark.parametrize("factor", [0.93, 0.97, 1.03, 1.07])
def test_a_rim_of_another_size_than_told_shifts_nothing(factor):
    seen = view(look=EVEN)
    _, e = scored(seen, lattice=replace(seen.lattice, rim_radius_mm=factor * seen.lattice.rim_radius_mm))
    assert rms_px(e) < 0.03
    assert abs(e.distance_mm[0]) < 0.15


def test_more_noise_means_more_error_and_as_much_more_sigma():
    errors = [scored(view(look=replace(REAL, read_noise=noise)))[1] for noise in (1.0, 5.0, 20.0)]
    rms = [rms_px(e) for e in errors]
    sigma = [float(np.median(e.measured_sigma_px)) for e in errors]
    assert rms[0] < rms[1] < rms[2] < 0.2
    assert sigma[0] < sigma[1] < sigma[2]
    assert sigma[2] / sigma[0] == pytest.approx(rms[2] / rms[0], rel=0.5)


@pytest.mark.parametrize("specks", [60, 150, 300])
def test_specks_cost_less_than_a_fifth(specks):
    """Pictures that are the same but for the specks: 300 here are 1200 at 640x480."""

    def of(count):
        return [scored(view(look=replace(REAL, specks=float(count)), seed=seed))[1] for seed in range(4)]

    plain, hit = of(0), of(specks)
    assert math.hypot(*map(rms_px, hit)) < 1.2 * math.hypot(*map(rms_px, plain))
    assert sum(len(e.measured_px) for e in hit) > 0.97 * sum(len(e.measured_px) for e in plain)
    for what in ("distance_mm", "tilt_deg"):
        more = math.hypot(*(getattr(e, what)[0] for e in hit))
        assert more < 1.2 * math.hypot(*(getattr(e, what)[0] for e in plain)) + getattr(hit[0], what)[1]


@pytest.mark.parametrize("gain", [0.2, 1.5, 8.0])
def test_too_little_light_and_too_much_are_borne(gain):
    look = replace(REAL, plate=min(1.0, 0.42 * gain), rim=0.85 * gain, weld=0.3 * gain)
    _, e = scored(view(look=look))
    assert e.missed == 0
    assert rms_px(e) < 0.2


def test_tubes_cut_by_the_border_are_known_less_well_than_others():
    m, _ = scored(view(look=REAL, pitch_px=24.0))
    xx, xy, yy = m.view.covariance_px[m.view.measured].T
    assert (xx > 0).all()
    assert (xx * yy > xy * xy).all()
    center = m.tubes.center_px[m.view.measured]
    inside = np.minimum(center, np.array([319, 239]) - center).min(axis=1)
    assert np.median((xx + yy)[inside < 5]) > 2 * np.median((xx + yy)[inside > 12])


def test_what_a_hose_covers_is_inferred_and_told_with_its_own_sigma():
    m, e = scored(view(look=replace(NOMINAL, lane_rows=0, wall=0.05), seed=2))
    assert len(e.inferred_px) > 5
    assert np.abs(e.inferred_px).max() < 0.5
    assert (m.tubes.sigma_px > 0).all()
    assert set(m.tubes.origin.tolist()) == {Origin.MEASURED, Origin.INFERRED}


@pytest.mark.parametrize("bits", [8, 16])
def test_nothing_of_an_answer_is_without_a_finite_value(bits):
    m, _ = scored(view(look=replace(REAL, specks=40.0), bits=bits))
    for values in (m.tubes.center_px, m.tubes.sigma_px, m.pose.rotation, m.pose.translation_mm, m.pose.covariance):
        assert np.isfinite(values).all()
    assert np.linalg.eigvalsh(m.pose.covariance).min() > 0
    assert np.allclose(m.pose.rotation @ m.pose.rotation.T, np.eye(3), atol=1e-12)
    assert m.elapsed_ms.keys() >= {"detect", "pose", "total"}


def test_tubes_so_large_that_their_walls_end_beyond_the_samples_are_measured_too():
    seen = view(look=replace(CLEAN, blur_px=0.6), size_px=(640, 480), pitch_px=150.0)
    _, e = scored(seen)
    assert rms_px(e) < 0.12
    assert e.missed == 0


@pytest.mark.parametrize("wall_px", [0.5, 8.0, 100.0])
def test_the_terms_of_a_ray_are_finite_however_thick_the_wall(wall_px):
    _, terms = shapes_of(replace(start_profile(0.8), learnt=True), wall_px)
    assert np.all(terms.information > 0)
    for numbers in (terms.basis, terms.first / terms.information, terms.edge, terms.moved, terms.prior):
        assert np.all(np.isfinite(numbers))


def off_px(seen, pose):
    """How far a pose is off in the picture's middle, px."""
    middle, v = np.zeros((1, 2)), seen.camera.vector()
    return float(np.hypot(*(project(v, *pose, middle) - project(v, seen.rotation, seen.translation_mm, middle))[0]))


@pytest.mark.parametrize("edges_off", [-1.9, -1.2, -0.5, 0.3, 1.0, 1.9])
@pytest.mark.parametrize("thought_px", [0.0, 2.0, 4.0])
def test_a_few_tubes_bring_a_pose_near(edges_off, thought_px):
    """From as far as an arm that speeds up gets ahead of its prediction, to what a full pass takes for settled."""
    seen = view(look=REAL)
    rotation, translation = seen.rotation, seen.translation_mm
    rows, columns = (a.ravel() for a in np.mgrid[-2:3, -2:3])
    guides, vector = seen.lattice.sheet_points(rows, columns), seen.camera.vector()
    learnt = measure_rims(
        seen.image, vector, rotation, translation, guides, seen.lattice, start_profile(1.0)
    ).profile()  # fmt: skip
    depth = float(translation[2])
    start = translation + np.array([edges_off * learnt.width_px * depth / vector[0], 0.0, 0.0])
    found = approach(seen.image, seen.camera, seen.lattice, rotation, start, guides, learnt, thought_px)
    assert off_px(seen, (rotation, start)) == pytest.approx(abs(edges_off) * learnt.width_px, rel=0.1)
    assert off_px(seen, found) < 0.15 * learnt.width_px


def test_a_pose_stays_as_it_was_where_too_few_tubes_show():
    seen = view(look=REAL)
    rotation, translation = seen.rotation, seen.translation_mm
    black = np.zeros_like(seen.image)
    guides = seen.lattice.sheet_points(np.arange(8), np.arange(8))
    found = approach(black, seen.camera, seen.lattice, rotation, translation, guides, start_profile(1.0), 0.0)
    assert found == (rotation, translation)


@pytest.mark.parametrize(
    ("turn_deg", "at_rest", "looks"), [(0.0, 0.05, 1), (0.05, 0.25, 1), (0.05, 0.05, 2), (0.2, 0.25, 2)]
)
def test_a_solution_far_from_where_rims_were_looked_for_is_looked_at_again(monkeypatch, turn_deg, at_rest, looks):
    """A turn about the picture's middle moves tubes to all sides: the median of their shifts says nothing of it."""
    seen, looked = view(look=REAL), []
    measure = refinement.measure_rims

    def noted(*args, **settings):
        looked.append(args)
        return measure(*args, **settings)

    start = refine(
        seen.image, seen.camera, seen.lattice, NO_PRIOR, seen.rotation, seen.translation_mm, start_profile(1.0),
        passes=10, watch=Stopwatch(lambda: 0),
    )  # fmt: skip
    turned = cv2.Rodrigues(np.radians([0.0, 0.0, turn_deg]))[0] @ start.fit.rotation
    monkeypatch.setattr(refinement, "measure_rims", noted)
    again = refine(
        seen.image, seen.camera, seen.lattice, NO_PRIOR, np.ascontiguousarray(turned), start.fit.translation_mm,
        start.common.profile, passes=10, watch=Stopwatch(lambda: 0), before=start.common, afresh=False,
        at_rest=at_rest,
    )  # fmt: skip
    assert len(looked) == looks
    assert again.moved_px < at_rest * again.common.profile.width_px


@pytest.mark.parametrize(("turn_deg", "there"), [(0.1, True), (0.6, False)])
def test_a_solution_that_is_far_from_where_it_was_looked_for_to_the_last_is_none(turn_deg, there):
    seen = view(look=REAL)
    start = refine(
        seen.image, seen.camera, seen.lattice, NO_PRIOR, seen.rotation, seen.translation_mm, start_profile(1.0),
        passes=10, watch=Stopwatch(lambda: 0),
    )  # fmt: skip
    turned = cv2.Rodrigues(np.radians([0.0, 0.0, turn_deg]))[0] @ start.fit.rotation
    again = refine(
        seen.image, seen.camera, seen.lattice, NO_PRIOR, np.ascontiguousarray(turned), start.fit.translation_mm,
        start.common.profile, passes=1, watch=Stopwatch(lambda: 0),
    )  # fmt: skip
    assert (again is not None) == there
