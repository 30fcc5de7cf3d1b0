from dataclasses import replace

import numpy as np
import pytest

from drivers.errors import CalibrationError
from service.alignment.geometry import compare, guide_foot, tube_end
from service.alignment.setup import Standing, solve_guide
from tests.alignment.scenes import (
    CAMERA,
    LATTICE,
    geometry_of,
    measure,
    places_in_view,
    random_pose,
    robust_sd,
    scattered,
    turned,
)

PLAY_MM = 0.3
"""Radial clearance of the rod that stands in the tubes."""
TRUE_POINT, TRUE_AXIS = np.array([40.0, -25.0, 900.0]), turned([0.02, -0.03, 0]) @ np.array([0, 0, 1.0])


def in_disc(rng, radius):
    angle, r = rng.uniform(0, 2 * np.pi), radius * np.sqrt(rng.uniform())
    return r * np.array([np.cos(angle), np.sin(angle)])


def held(rng, R, end_mm, inserted_mm=0.0, distance_mm=950.0):
    """Pose, near `R`, of a camera whose guide enters the tube at `end_mm`: with play there, and where it reaches to."""
    end, depth = in_disc(rng, PLAY_MM), in_disc(rng, PLAY_MM)
    d = np.array([*((depth - end) / inserted_mm if inserted_mm else rng.normal(0, 0.01, 2)), 1.0])
    # Turn the camera so that the true axis lies along d of the sheet, then move it so that it passes the tube's end
    w = np.cross(R @ d / np.linalg.norm(d), TRUE_AXIS)
    R = turned(w / np.linalg.norm(w) * np.arcsin(np.linalg.norm(w))) @ R
    passes = TRUE_POINT + (distance_mm - 900.0) / TRUE_AXIS[2] * TRUE_AXIS
    return R, passes - R @ np.array([*(end_mm[:2] + end), 0.0])


def stood(rng, *, inserted_mm=0.0, distance_mm=950.0, pictures=1, noise_px=0.05):
    """Measurements of one standing over the tube in the middle of the view, and the tube's place."""
    R, t = random_pose(rng, distance_mm)
    places = places_in_view(CAMERA, LATTICE, R, t)
    tubes_mm = scattered(rng, LATTICE, places)
    i = int(np.argmin(np.hypot(*(LATTICE.sheet_points(*places) - (R.T @ -t)[:2]).T)))
    place = int(places[0][i]), int(places[1][i])
    R, t = held(rng, R, tubes_mm[place], inserted_mm, distance_mm)
    return [measure(rng, CAMERA, LATTICE, R, t, places, tubes_mm, noise_px, CAMERA) for _ in range(pictures)], place


def stand(rng, *, inserted_mm=0.0, label="frame 0", **how):
    """A standing of the guide over a tube."""
    seen, place = stood(rng, inserted_mm=inserted_mm, **how)
    return Standing(label, [(m.pose, tube_end(m, place, LATTICE)) for m in seen], inserted_mm)


def error_of(setup):
    """Of the axis at the setup's point (2,) mm, and of its direction (2,) rad, with their covariances."""
    guide = setup.guide
    at = TRUE_POINT + TRUE_AXIS * ((guide.point_mm - TRUE_POINT) @ TRUE_AXIS)
    across = np.linalg.svd(guide.direction[None])[2][1:]
    C = guide.covariance
    shift, turn = across @ (guide.point_mm - at), across @ np.cross(TRUE_AXIS, guide.direction)
    return shift, across @ C[3:, 3:] @ across.T, turn, across @ C[:3, :3] @ across.T


def test_errors_of_the_axis_are_as_large_as_its_covariance_says():
    z_shift, z_turn = [], []
    for seed in range(80):
        rng = np.random.default_rng(seed)
        made = [stand(rng, inserted_mm=60.0, label=f"frame {k}") for k in range(4)]
        shift, of_shift, turn, of_turn = error_of(solve_guide(made, PLAY_MM / 2))
        z_shift.extend(shift / np.sqrt(np.diag(of_shift)))
        z_turn.extend(turn / np.sqrt(np.diag(of_turn)))
    assert 0.75 < robust_sd(z_shift) < 1.2
    assert 0.75 < robust_sd(z_turn) < 1.2


def test_pictures_at_two_distances_tell_the_direction_without_anything_inserted():
    z = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        made = [stand(rng, distance_mm=d, label=f"{d}") for d in (900.0, 900.0, 1000.0, 1000.0)]
        setup = solve_guide(made, PLAY_MM / 2)
        assert setup.depth_mm == pytest.approx(100, abs=5)
        assert setup.turn_sigma_deg < 0.2
        _, _, turn, of_turn = error_of(setup)
        z.extend(turn / np.sqrt(np.diag(of_turn)))
    assert 0.7 < robust_sd(z) < 1.25


def test_one_picture_of_a_guide_over_a_tube_does_not_tell_its_direction():
    rng = np.random.default_rng(0)
    with pytest.raises(CalibrationError, match=r"direction is known to 15.0 deg only.* \(--inserted-mm\)"):
        solve_guide([stand(rng)], PLAY_MM / 2)
    with pytest.raises(CalibrationError, match="direction"):
        solve_guide([stand(rng, label=str(k)) for k in range(6)], PLAY_MM / 2)


def test_one_picture_with_a_rod_inserted_does_and_says_how_well():
    setup = solve_guide([stand(np.random.default_rng(0), inserted_mm=60.0)], PLAY_MM / 2)
    assert setup.points == 2
    assert setup.turn_sigma_deg == pytest.approx(np.degrees(np.sqrt(2) * 0.15 / 60), rel=0.1)
    assert setup.shift_sigma_mm == pytest.approx(0.15 / np.sqrt(2), rel=0.3)


def test_a_short_rod_says_how_long_it_must_be():
    with pytest.raises(CalibrationError, match=r"at least 30 mm into the tube"):
        solve_guide([stand(np.random.default_rng(0), inserted_mm=8.0)], PLAY_MM / 2)


def test_many_pictures_of_one_standing_are_one_play():
    one, many = (
        solve_guide([stand(np.random.default_rng(0), inserted_mm=60.0, pictures=n)], PLAY_MM / 2) for n in (1, 30)
    )
    assert many.shift_sigma_mm > 0.9 * one.shift_sigma_mm


def test_what_all_pictures_share_does_not_average_out():
    """The pose's common error stays in the covariance, however many standings there are."""
    rng = np.random.default_rng(0)
    made = [stand(rng, inserted_mm=60.0, label=str(k)) for k in range(20)]
    shared = np.diag([0, 0, 0, 0.3**2, 0.3**2, 0])
    made = [
        replace(s, views=[(replace(p, covariance=p.covariance + shared), tube) for p, tube in s.views]) for s in made
    ]
    assert solve_guide(made, PLAY_MM / 2).shift_sigma_mm == pytest.approx(0.3, rel=0.1)


def test_a_picture_over_another_tube_is_found_and_named():
    rng = np.random.default_rng(1)
    made = [stand(rng, inserted_mm=60.0, label=f"frame {k}") for k in range(4)]
    pose, tube = made[2].views[0]
    wrong = replace(tube, center_mm=tube.center_mm + np.array([25.4, 0.0]))
    made[2] = replace(made[2], views=[(pose, wrong)])
    with pytest.raises(CalibrationError, match=r"frame 2: lies .* over another tube"):
        solve_guide(made, PLAY_MM / 2)


def test_nothing_to_go_by_is_said():
    with pytest.raises(CalibrationError, match="no picture shows"):
        solve_guide([], PLAY_MM / 2)


def test_a_measured_gap_tells_where_the_mouth_is():
    rng = np.random.default_rng(3)
    made = [stand(rng, inserted_mm=60.0, label=str(k)) for k in range(4)]
    setup = solve_guide(made, PLAY_MM / 2, gap_mm=20.0, gap_sigma_mm=0.3)
    assert setup.guide.at_mouth
    pose, tube = made[0].views[0]
    lean = compare(pose, LATTICE, geometry_of(setup.guide), tube)
    assert lean.gap_mm == pytest.approx(20.0, abs=0.3)
    assert lean.covariance[4, 4] ** 0.5 == pytest.approx(0.3, rel=0.2)
    without = solve_guide(made, PLAY_MM / 2)
    assert not without.guide.at_mouth
    assert guide_foot(pose, without.guide) == pytest.approx(guide_foot(pose, setup.guide), abs=1e-9)


def test_a_guide_set_up_so_gives_offsets_true_to_their_sigma():
    """From setup to use, with the same camera: the offset of the true axis from tubes never used before."""
    z = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        setup = solve_guide([stand(rng, inserted_mm=60.0, label=str(k)) for k in range(4)], PLAY_MM / 2)
        R, t = random_pose(rng, 940.0, 2.0)
        places = places_in_view(CAMERA, LATTICE, R, t, 60)
        tubes_mm = scattered(rng, LATTICE, places)
        m = measure(rng, CAMERA, LATTICE, R, t, places, tubes_mm, 0.05, CAMERA)
        place = int(places[0][0]), int(places[1][0])
        lean = compare(m.pose, LATTICE, geometry_of(setup.guide), tube_end(m, place, LATTICE))
        p, d = R.T @ (TRUE_POINT - t), R.T @ TRUE_AXIS
        true = p[:2] - d[:2] * p[2] / d[2] - tubes_mm[place][:2]
        z.extend((lean.offset_mm - true) / np.sqrt(np.diag(lean.covariance)[:2]))
    assert 0.7 < robust_sd(z) < 1.25
