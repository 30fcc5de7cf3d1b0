"""A camera from the sheet itself: what pictures tell, and what they do not, against exact physics."""

from dataclasses import replace

import numpy as np
import pytest

from service.vision.bundle import SMOOTH_PX, Range
from service.vision.camera import OpenCVLens, TsaiLens
from service.vision.errors import DegenerateError
from service.vision.selfcalibration import BLIND, calibrate
from tests.vision.installation import LATTICE, TRUE, UNKNOWN, Sheet, installation, seen_from, tilted

NAMES = ("focal_length_mm", "sx", "cx_px", "cy_px", "kappa1_per_mm2")


def value(camera, name):
    point = camera.principal_point_px
    return {
        "focal_length_mm": camera.focal_length_mm,
        "sx": camera.sx,
        "cx_px": point[0],
        "cy_px": point[1],
        "kappa1_per_mm2": camera.lens.kappa1_per_mm2,
    }[name]


def off(camera):
    return np.array([value(camera, n) - value(TRUE, n) for n in NAMES])


def sigma(camera, name="focal_length_mm"):
    i = camera.parameters.index(name)
    return float(np.sqrt(camera.covariance[i, i]))


def single(scatter_mm, camera=TRUE, known=UNKNOWN, known_range=None, seed=1):
    sheet = Sheet(np.random.default_rng(seed), scatter_mm)
    return calibrate([sheet.picture(seen_from(2.0, 0.0), camera)], known, LATTICE, known_range).camera


@pytest.mark.parametrize("seed", range(4))
def test_an_installation_of_many_tilts_tells_the_focal_length(seed):
    camera = calibrate(installation(seed, 24), UNKNOWN, LATTICE).camera
    error = camera.focal_length_mm - TRUE.focal_length_mm
    assert abs(error) < 1e-3 * TRUE.focal_length_mm
    assert abs(error) < 2.5 * sigma(camera)
    assert sigma(camera) < 6e-4 * TRUE.focal_length_mm


def test_errors_are_what_the_covariance_says():
    runs = 40
    chi2, z = 0.0, []
    for seed in range(runs):
        camera = calibrate(installation(100 + seed, bend_px=SMOOTH_PX), UNKNOWN, LATTICE).camera
        order = [camera.parameters.index(n) for n in NAMES]
        covariance, error = camera.covariance[np.ix_(order, order)], off(camera)
        chi2 += error @ np.linalg.solve(covariance, error)
        z.append(error / np.sqrt(np.diag(covariance)))
    degrees = runs * len(NAMES)
    assert 0.7 < chi2 / degrees < 1.35
    assert (np.abs(np.mean(z, axis=0)) < 1.0).all()
    assert (np.std(z, axis=0) > 0.6).all()
    assert (np.std(z, axis=0) < 1.5).all()


@pytest.mark.parametrize(("scatter_mm", "least"), [(0.0, 0.015), (0.06, 0.05)])
def test_one_nearly_frontal_picture_does_not_pretend_to_know_the_focal_length(scatter_mm, least):
    for known in (UNKNOWN, replace(UNKNOWN, sx=TRUE.sx)):
        camera = single(scatter_mm, known=known)
        assert sigma(camera) > least * camera.focal_length_mm
        assert abs(camera.focal_length_mm - TRUE.focal_length_mm) < 3 * sigma(camera)


def test_one_nearly_frontal_picture_tells_the_distance_by_the_focal_length():
    calibration = calibrate([Sheet(np.random.default_rng(1)).picture(seen_from(2.0, 0.0))], UNKNOWN, LATTICE)
    f = calibration.camera.focal_length_mm
    pivot = calibration.solution.pivot_mm[0]
    truth = seen_from(2.0, 0.0)
    expected = (truth[0][2, :2] @ np.array([3.0, 5.0]) + truth[1][2]) / TRUE.focal_length_mm
    assert pivot[2] / f == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("tilt_deg", [0.2, 2.0])
def test_a_focal_length_that_is_no_more_than_guessed_is_not_its_own_prior(tilt_deg):
    """Where a picture's own f collapsed, the answer must not be as certain as that is small."""
    picture = Sheet(np.random.default_rng(1)).picture(seen_from(tilt_deg, 0.0))
    f = 0.2 * TRUE.focal_length_mm
    collapsed = replace(
        picture,
        camera=replace(picture.camera, focal_length_mm=f),
        focal_sigma_mm=0.9 * f,
        translation_mm=seen_from(tilt_deg, 0.0, 0.2 * 1066)[1],
    )
    camera = calibrate([collapsed], UNKNOWN, LATTICE).camera
    assert sigma(camera) > 0.3 * camera.focal_length_mm
    assert abs(camera.focal_length_mm - TRUE.focal_length_mm) < 2 * sigma(camera)


def test_a_known_range_tells_the_focal_length_of_a_single_picture():
    rotation, translation = seen_from(2.0, 0.0)
    known = Range(float(rotation[:, 2] @ translation), 2.0)
    camera = single(0.06, known_range=known)
    assert sigma(camera) == pytest.approx(2.0 / 1066 * camera.focal_length_mm, rel=0.5)
    assert abs(camera.focal_length_mm - TRUE.focal_length_mm) < 3 * sigma(camera)


def test_a_known_focal_length_holds_as_well_as_it_is_known():
    known = replace(UNKNOWN, focal_length_mm=6.6, parameters=("focal_length_mm",), covariance=np.array([[0.1**2]]))
    camera = single(0.06, known=known)
    assert camera.focal_length_mm == pytest.approx(6.6, abs=0.15)
    assert sigma(camera) == pytest.approx(0.1, rel=0.2)


def test_what_is_given_without_sigma_stays():
    known = replace(UNKNOWN, principal_point_px=TRUE.principal_point_px, sx=TRUE.sx, lens=TRUE.lens)
    camera = calibrate(installation(), known, LATTICE).camera
    assert camera.principal_point_px == TRUE.principal_point_px
    assert (camera.sx, camera.lens) == (TRUE.sx, TRUE.lens)
    assert camera.parameters == ("focal_length_mm",)


def test_the_same_pose_again_and_again_adds_little_as_its_tubes_err_alike():
    sheet = Sheet(np.random.default_rng(3))
    pictures = [sheet.picture(seen_from(7.0, 0.0)) for _ in range(16)]
    known = replace(UNKNOWN, sx=TRUE.sx, principal_point_px=TRUE.principal_point_px)
    one, all_of_them = (calibrate(p, known, LATTICE).camera for p in (pictures[:1], pictures))
    assert sigma(all_of_them) > 0.5 * sigma(one)


def test_pictures_whose_tilts_differ_tell_the_horizontal_scale():
    sheet = Sheet(np.random.default_rng(3))
    alike = [sheet.picture(seen_from(7.0, 0.0)) for _ in range(2)]
    crossed = [sheet.picture(seen_from(*t)) for t in ((7.0, 0.0), (0.0, 7.0))]
    assert sigma(calibrate(alike, UNKNOWN, LATTICE).camera) > 20 * sigma(calibrate(crossed, UNKNOWN, LATTICE).camera)


def test_scatter_is_estimated_where_it_is_not_as_stated():
    stated = replace(LATTICE, scatter_mm=0.02)
    found = calibrate(installation(5, scatter_mm=0.08), UNKNOWN, stated).solution.spread.scatter[0] * 0.02
    assert found == pytest.approx(0.08, rel=0.25)


def test_what_is_grossly_wrong_is_set_aside():
    pictures = installation(6)
    for k in pictures:
        k.center_px[::17] += 3.0
    camera = calibrate(pictures, UNKNOWN, LATTICE).camera
    assert abs(camera.focal_length_mm - TRUE.focal_length_mm) < 3 * sigma(camera)


def test_a_lens_that_one_term_does_not_describe_gets_two():
    bent = replace(TRUE, lens=OpenCVLens((-0.3, -0.1, 0.0, 0.0, 0.0)))
    rng = np.random.default_rng(7)
    sheet = Sheet(rng)
    camera = calibrate([sheet.picture(p, bent) for p in tilted(rng, 12)], UNKNOWN, LATTICE).camera
    assert isinstance(camera.lens, OpenCVLens)
    assert camera.lens.coefficients[:2] == pytest.approx((-0.3, -0.1), abs=0.03)
    assert {"k1", "k2"} < set(camera.parameters)
    assert isinstance(calibrate(installation(7), UNKNOWN, LATTICE).camera.lens, TsaiLens)


def test_pictures_of_unlike_index_count_as_of_other_tubes():
    rng = np.random.default_rng(8)
    sheet = Sheet(rng)
    pictures = [sheet.picture(p) for p in tilted(rng, 6)]
    together = calibrate(pictures, UNKNOWN, LATTICE)
    apart = calibrate([replace(p, series=i) for i, p in enumerate(pictures)], UNKNOWN, LATTICE)
    assert together.bundle.tubes < apart.bundle.tubes == sum(len(p) for p in pictures)


def test_without_a_picture_that_shows_enough_there_is_no_answer():
    few = Sheet(np.random.default_rng(9)).picture(seen_from(2.0, 0.0), seen=0.05)
    for pictures in ([], [few]):
        with pytest.raises(DegenerateError, match="12 tubes"):
            calibrate(pictures, UNKNOWN, LATTICE)


def test_a_first_answer_knows_the_focal_length_less_well_and_all_else_alike():
    calibration = calibrate(installation(1, 24), UNKNOWN, LATTICE)
    first = calibration.first_answer().camera
    assert sigma(first) == pytest.approx(BLIND * sigma(calibration.camera))
    assert np.linalg.eigvalsh(first.covariance).min() > 0
    assert sigma(first, "cx_px") == sigma(calibration.camera, "cx_px")
    assert calibrate(installation(1), TRUE, LATTICE).first_answer().camera.parameters == ()
