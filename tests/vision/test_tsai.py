import json
import math

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from service.vision.camera import Camera, TsaiLens
from service.vision.errors import DegenerateError
from service.vision.tsai import calibrate_coplanar
from service.vision.tsai_full import calibrate_full, tsai_polish
from service.vision.tsai_model import jacobian, projected
from service.vision.tsai_result import TsaiResult, with_values

SETS = ("S1_n00", "S1_n05", "S1_n20", "S3_n00", "S3_n05", "S3_n20", "S5_n00", "S5_n05", "S5_n20", "cc_cd")
METHODS = (calibrate_coplanar, tsai_polish, calibrate_full)
CENTER = (652.0, 498.0)
PITCH = 0.005


def turned(rx_deg, ry_deg, rz_deg):
    (ca, sa), (cb, sb), (cg, sg) = ((math.cos(a), math.sin(a)) for a in np.radians((rx_deg, ry_deg, rz_deg)))
    return np.array(
        [
            [cb * cg, cg * sa * sb - ca * sg, sa * sg + ca * cg * sb],
            [cb * sg, sa * sb * sg + ca * cg, ca * sb * sg - cg * sa],
            [-sb, cb * sa, ca * cb],
        ]
    )


class Scene:
    """A sheet of points before a camera, pictured here by Tsai's equations alone."""

    def __init__(
        self, tilt_deg=(7.0, -4.0), spin_deg=3.0, f_mm=18.8, kappa1=8e-4, sx=1.0, count=(14, 12), mirrored=False
    ):
        self.f, self.kappa1, self.sx = f_mm, kappa1, sx
        self.rotation = turned(*tilt_deg, spin_deg) @ np.diag([1.0, -1, -1] if mirrored else [1.0, 1, 1])
        nx, ny = count
        grid = np.array([[x * 310.0 / nx, y * 240.0 / ny] for y in range(ny) for x in range(nx)])
        middle = np.array([150.0, 115.0])
        self.translation = np.array([4.0, -6.0, 1066.0]) - self.rotation[:, :2] @ middle
        self.sheet = grid
        self.camera = Camera((1280, 1024), (PITCH, PITCH), principal_point_px=CENTER, sx=sx)

    def picture(self, noise_px=0.0, seed=0):
        x, y, z = self.rotation[:, :2] @ self.sheet.T + self.translation[:, None]
        undistorted = self.f * np.stack((x / z, y / z), axis=1)
        distorted = undistorted.copy()
        for _ in range(200):
            distorted = undistorted / (1 + self.kappa1 * (distorted**2).sum(axis=1, keepdims=True))
        px = distorted / PITCH * [self.sx, 1] + CENTER
        return px + np.random.default_rng(seed).normal(0, noise_px, px.shape) if noise_px else px

    def moved(self, origin):
        """The same sheet, its coordinates counted from another point of it."""
        self.sheet = self.sheet - origin
        self.translation = self.translation + self.rotation[:, :2] @ origin
        return self

    def center_on_sheet(self):
        return np.linalg.solve(self.rotation[:2, :2], -self.translation[:2])

    @property
    def tz_over_f(self):
        return self.translation[2] / self.f


def camera_of(name):
    if name == "cc_cd":
        return Camera((576, 384), (0.023, 0.023), principal_point_px=(258.0, 204.0))
    return Camera((1280, 1024), (0.005, 0.005), principal_point_px=(640.0, 512.0))


def willson(folder, name, suffix=""):
    data = np.loadtxt(folder / f"{name}.dat")
    return data[:, :2], data[:, 3:], np.loadtxt(folder / f"{name}{suffix}") if suffix else None


# Willson's programs


@pytest.mark.shared
@pytest.mark.parametrize("name", SETS)
def test_tsai_is_what_ccal_printed(shared, name):
    sheet, picture, printed = willson(shared / "willson", name, ".ccal.stdout")
    result = calibrate_coplanar(sheet, picture, camera_of(name))
    tolerance = 1e-4 if name.startswith("S3") else 1e-5
    assert (result.focal_length_mm, result.kappa1_per_mm2) == pytest.approx(printed[9:11], rel=tolerance)
    assert result.translation_mm == pytest.approx(printed[11:14], rel=tolerance)
    assert result.rotation == pytest.approx(turned(*np.degrees(printed[14:17])), rel=tolerance)
    assert (*result.principal_point_px, result.sx) == pytest.approx(printed[6:9])


@pytest.mark.shared
@pytest.mark.parametrize("name", SETS)
def test_full_is_no_worse_than_ccal_fo(shared, name):
    sheet, picture, printed = willson(shared / "willson", name, ".ccal_fo.stdout")
    result = calibrate_full(sheet, picture, camera_of(name))
    camera = with_values(camera_of(name), printed[9], printed[10], (printed[6], printed[7]))
    his = TsaiResult("full", camera, turned(*np.degrees(printed[14:17])), printed[11:14])
    squares = ((projected(his, np.column_stack((sheet, np.zeros(len(sheet))))) - picture) ** 2).sum()
    assert result.sum_of_squares_px2 <= 1.001 * squares
    assert result.tz_over_f == pytest.approx(his.tz_over_f, rel=1e-4)


@pytest.mark.shared
@pytest.mark.parametrize("name", SETS[:-1])
def test_polish_is_the_least_squares_of_the_picture(shared, name):
    folder = shared / "willson"
    sheet, picture, _ = willson(folder, name)
    lines = (folder / f"{name}.ml.txt").read_text().splitlines()
    f, kappa1, *translation = (float(v) for v in lines[1].split()[:5])
    result = tsai_polish(sheet, picture, camera_of(name))
    assert (result.focal_length_mm, result.kappa1_per_mm2) == pytest.approx((f, kappa1), rel=3e-6)
    assert result.translation_mm == pytest.approx(translation, rel=3e-6)
    rms = math.sqrt(result.sum_of_squares_px2 / result.points)
    assert rms == pytest.approx(float(lines[2].split()[0]), rel=1e-5, abs=1e-6)


@pytest.mark.shared
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["S1", "S3", "S5"])
def test_the_truth_is_found_without_noise(shared, name, method):
    sheet, picture, _ = willson(shared / "willson", f"{name}_n00")
    truth = json.loads((shared / "willson" / f"{name}_truth.json").read_text())
    result = method(sheet, picture, camera_of(name))
    assert (result.focal_length_mm, result.kappa1_per_mm2) == pytest.approx((truth["f"], truth["kappa1"]), rel=1e-6)
    assert result.translation_mm == pytest.approx([truth[k] for k in ("Tx", "Ty", "Tz")], rel=1e-6)
    assert result.angles_deg == pytest.approx([truth[k] for k in ("Rx_deg", "Ry_deg", "Rz_deg")], abs=1e-5)


def test_tsai_stops_where_ccal_stops():
    """His program's answer, to all its digits; the minimum itself lies 2e-3 away."""
    sheet = np.array([[x, y] for y in (15.0, 55, 95, 135, 175) for x in (20.0, 132, 244)])
    picture = np.array(
        [
            (192.49, 86.61), (378.64, 127.73), (560.03, 167.58), (178.51, 153.25), (363.49, 193.12),
            (544.05, 232.19), (164.59, 219.10), (348.49, 258.01), (528.12, 295.90), (150.66, 284.23),
            (333.75, 321.70), (512.50, 358.85), (136.71, 348.43), (319.25, 384.96), (496.99, 421.28),
        ]
    )  # fmt: skip
    result = calibrate_coplanar(sheet, picture, Camera((640, 480), (0.006, 0.006), principal_point_px=(330.0, 236.0)))
    assert result.focal_length_mm == pytest.approx(9.458718153311676, rel=1e-7)
    assert result.kappa1_per_mm2 == pytest.approx(-0.001438914940479399, rel=1e-6)
    assert result.translation_mm == pytest.approx([-96.33224590146166, -105.7847334834901, 917.5483960442235], rel=1e-7)
    assert np.radians(result.angles_deg) == pytest.approx(
        [0.14289907529845963, -0.10813229183077754, 0.20925403257851713], abs=1e-9
    )


# Recovery


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "scene",
    [
        Scene(),
        Scene(tilt_deg=(1.5, -1.4), kappa1=-5e-4),
        Scene(tilt_deg=(-25, 24), kappa1=-2e-3, f_mm=12.0, spin_deg=140.0),
        Scene(sx=1.08),
        Scene(sx=0.93, mirrored=True, spin_deg=-75.0),
        Scene(count=(4, 3), tilt_deg=(12, 9)),
    ],
    ids=["7 deg", "2 deg", "35 deg barrel", "stretched", "mirrored", "12 points"],
)
def test_a_picture_without_noise_gives_the_truth(scene, method):
    result = method(scene.sheet, scene.picture(), scene.camera)
    assert result.focal_length_mm == pytest.approx(scene.f, rel=1e-5)
    assert result.kappa1_per_mm2 == pytest.approx(scene.kappa1, rel=1e-4)
    assert result.principal_point_px == pytest.approx(CENTER, abs=0.05)
    assert result.translation_mm == pytest.approx(scene.translation, rel=1e-4)
    assert result.rotation == pytest.approx(scene.rotation, abs=1e-5)
    assert result.sx == scene.sx
    assert result.sum_of_squares_px2 < 1e-3


def test_what_the_camera_leaves_open_stands_at_its_neutral_value():
    scene = Scene()
    result = calibrate_coplanar(scene.sheet, scene.picture(), Camera((1305, 997), (PITCH, PITCH), sx=None))
    assert result.principal_point_px == CENTER
    assert result.sx == 1.0
    assert result.focal_length_mm == pytest.approx(scene.f, rel=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_the_sheets_height_counts(method):
    scene = Scene()
    level = np.column_stack((scene.sheet, np.full(len(scene.sheet), 5.0)))
    result = method(level, scene.picture(), scene.camera)
    assert result.translation_mm == pytest.approx(scene.translation - 5 * scene.rotation[:, 2], rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_full_finds_a_principal_point_far_off(seed):
    scene = Scene(kappa1=2e-3)
    off = 70 * np.array([math.cos(seed * 1.6), math.sin(seed * 1.6)])
    started = Camera((1280, 1024), (PITCH, PITCH), principal_point_px=tuple(CENTER + off))
    result = calibrate_full(scene.sheet, scene.picture(0.05, seed), started)
    assert result.principal_point_px == pytest.approx(CENTER, abs=5 * max(result.sigma.principal_point_px))
    assert result.focal_length_mm == pytest.approx(scene.f, abs=5 * result.sigma.focal_length_mm)
    assert result.tz_over_f == pytest.approx(scene.tz_over_f, rel=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_full_is_the_least_squares_of_weak_points(seed):
    """Two degrees of tilt and much noise leave a long flat valley; its bottom is found all the same."""
    scene = Scene(tilt_deg=(1.5, -1.3), spin_deg=-8.0)
    sheet, picture = np.column_stack((scene.sheet, np.zeros(len(scene.sheet)))), scene.picture(0.2, seed)

    def residuals(p):
        camera = with_values(
            scene.camera, scene.f * (1 + p[6]), scene.kappa1 + p[7], (CENTER[0] + p[8], CENTER[1] + p[9])
        )
        rotation = cv2.Rodrigues(p[:3])[0] @ scene.rotation
        return (projected(TsaiResult("full", camera, rotation, scene.translation + p[3:6]), sheet) - picture).ravel()

    lowest = least_squares(residuals, np.zeros(10), x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12)
    result = calibrate_full(scene.sheet, picture, scene.camera)
    assert lowest.success
    assert result.sum_of_squares_px2 < 1.0002 * 2 * lowest.cost
    scale = (scene.translation + lowest.x[3:6])[2] / (scene.f * (1 + lowest.x[6]))
    assert result.tz_over_f == pytest.approx(scale, rel=2e-5)


@pytest.mark.parametrize("seed", range(6))
def test_full_takes_from_tsais_stages_what_the_points_leave_open(seed):
    """Without distortion and all but parallel, f and the principal point stand together; ccal_fo answers too."""
    scene = Scene(tilt_deg=(1.5, -1.3), kappa1=0.0)
    picture = scene.picture(0.05, seed)
    result = calibrate_full(scene.sheet, picture, scene.camera)
    assert abs(math.log(result.focal_length_mm / scene.f)) < 0.6
    assert result.sigma.focal_length_mm > 0.3 * scene.f
    assert result.tz_over_f == pytest.approx(scene.tz_over_f, rel=1e-3)


def test_full_without_distortion_leaves_the_principal_point_near_its_start():
    """A plane pictured without distortion has two figures for three unknowns: f, Cx and Cy."""
    scene = Scene(kappa1=0.0)
    result = calibrate_full(scene.sheet, scene.picture(0.1), scene.camera)
    assert result.sigma.focal_length_mm > 0.1 * scene.f
    assert result.focal_length_mm == pytest.approx(scene.f, abs=4 * result.sigma.focal_length_mm)
    assert any("f and Tz are known to" in doubt for doubt in result.doubts)
    assert result.tz_over_f == pytest.approx(scene.tz_over_f, rel=1e-3)


# How well it is known


def test_the_derivatives_are_those_of_the_projection():
    scene = Scene(kappa1=-2e-3, sx=1.05)
    sheet = np.column_stack((scene.sheet, np.full(len(scene.sheet), 3.0)))
    at = TsaiResult("full", with_values(scene.camera, 17.0, -2e-3, CENTER), scene.rotation, scene.translation)

    def stepped(k, h):
        d = np.zeros(10)
        d[k] = h
        small = np.array([[1, -d[2], d[1]], [d[2], 1, -d[0]], [-d[1], d[0], 1]])
        camera = with_values(scene.camera, 17.0 + d[6], -2e-3 + d[7], (CENTER[0] + d[8], CENTER[1] + d[9]))
        return projected(TsaiResult("full", camera, small @ at.rotation, at.translation_mm + d[3:6]), sheet)

    for k, h in enumerate([1e-6] * 3 + [1e-3] * 4 + [1e-8] + [1e-3] * 2):
        numeric = (stepped(k, h) - stepped(k, -h)) / (2 * h)
        np.testing.assert_allclose(jacobian(at, sheet)[:, :, k], numeric, rtol=1e-5, atol=1e-5 * np.abs(numeric).max())


@pytest.mark.parametrize(
    ("method", "least", "most"), [(tsai_polish, 0.75, 1.3), (calibrate_full, 0.75, 1.3), (calibrate_coplanar, 1.0, 2.2)]
)
def test_answers_scatter_as_their_sigma_says(method, least, most):
    """Sigma is the Cramer-Rao bound; the fits reach it, Tsai's two stages do not."""
    scene = Scene(tilt_deg=(6.0, -9.0), kappa1=2e-3)
    results = [method(scene.sheet, scene.picture(0.1, seed), scene.camera) for seed in range(80)]
    f = np.array([r.focal_length_mm for r in results])
    assert least < f.std() / np.median([r.sigma.focal_length_mm for r in results]) < most
    assert abs(f.mean() - scene.f) < 4 * f.std() / math.sqrt(len(f))
    scale = np.array([r.tz_over_f for r in results])
    assert 0.75 < scale.std() / np.median([r.sigma.tz_over_f for r in results]) < 1.7
    if method is calibrate_full:
        centers = np.array([r.principal_point_px for r in results])
        ratio = centers.std(axis=0) / np.median([r.sigma.principal_point_px for r in results], axis=0)
        assert np.all((ratio > 0.7) & (ratio < 1.3))
    else:
        assert {r.sigma.principal_point_px for r in results} == {(0.0, 0.0)}


@pytest.mark.parametrize("seed", range(30))
def test_no_set_of_points_gives_an_absurd_answer_in_silence(seed):
    rng = np.random.default_rng(seed)
    tilt, azimuth = rng.uniform(2, 35), rng.uniform(0, 2 * np.pi)
    scene = Scene(
        tilt_deg=(tilt * math.cos(azimuth), tilt * math.sin(azimuth)),
        spin_deg=rng.uniform(-180, 180),
        kappa1=rng.uniform(-3e-3, 3e-3),
        sx=rng.uniform(0.9, 1.1),
        mirrored=bool(seed % 3 == 0),
    )
    kept = rng.choice(len(scene.sheet), rng.integers(20, len(scene.sheet)), replace=False)
    noise_px = rng.uniform(0, 0.3)
    for method in METHODS:
        try:
            result = method(scene.sheet[kept], scene.picture(noise_px, seed)[kept], scene.camera)
        except DegenerateError:
            assert tilt < 6
            continue
        assert result.tz_over_f == pytest.approx(scene.tz_over_f, rel=5e-3)
        assert abs(result.focal_length_mm - scene.f) < 8 * result.sigma.focal_length_mm + 1e-4


# What cannot be answered


def collinear(scene, picture):
    row = scene.sheet[:, 1] == 0
    return scene.sheet[row], picture[row]


def edge_on(scene, picture):
    return scene.sheet, picture * [1, 0] + [0, 400]


def shuffled(scene, picture):
    return scene.sheet, np.random.default_rng(1).permutation(picture)


def with_nan(scene, picture):
    picture[6, 1] = math.nan
    return scene.sheet, picture


def of_two_heights(scene, picture):
    return np.column_stack((scene.sheet, np.arange(len(picture)) % 2)), picture


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("spoiled", "message"),
    [
        (lambda s, p: (s.sheet[:4], p[:4]), r"4 different points; give at least [57]"),
        (lambda s, p: (np.repeat(s.sheet[:4], 9, 0), np.repeat(p[:4], 9, 0)), "4 different points"),
        (collinear, "on one line of the sheet"),
        (edge_on, "on one line of the picture"),
        (with_nan, "point 7 of 168 is not finite"),
        (of_two_heights, "zw runs from 0 to 1"),
        (shuffled, "order|resembles|check that"),
    ],
    ids=["few", "repeated", "collinear", "edge-on", "nan", "two heights", "shuffled"],
)
def test_points_that_determine_nothing_are_refused(method, spoiled, message):
    scene = Scene()
    with pytest.raises(DegenerateError, match=message):
        method(*spoiled(scene, scene.picture()), scene.camera)


@pytest.mark.parametrize("method", METHODS)
def test_shapes_that_do_not_fit_are_a_mistake_of_the_caller(method):
    scene = Scene()
    with pytest.raises(ValueError, match=r"points_mm \(168, 2\) and points_px \(167, 2\)"):
        method(scene.sheet, scene.picture()[1:], scene.camera)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kappa1", [0.0, 1e-3])
def test_a_parallel_sheet_without_noise_is_refused(method, kappa1):
    scene = Scene(tilt_deg=(0.0, 0.0), kappa1=kappa1)
    with pytest.raises(DegenerateError, match=r"cannot be told apart.*7 deg"):
        method(scene.sheet, scene.picture(), scene.camera)


@pytest.mark.parametrize("seed", range(12))
def test_a_parallel_sheet_with_noise_is_refused_or_doubted(seed):
    scene = Scene(tilt_deg=(0.0, 0.0))
    for method in METHODS:
        try:
            result = method(scene.sheet, scene.picture(0.1, seed), scene.camera)
        except DegenerateError:
            continue
        assert any("f and Tz" in doubt for doubt in result.doubts)


@pytest.mark.parametrize("where", ["axis", "middle"])
def test_an_origin_on_the_cameras_x_axis_is_refused_by_tsai_alone(where):
    scene = Scene()
    center = scene.center_on_sheet()
    along = np.array([scene.rotation[1, 1], -scene.rotation[1, 0]])
    scene.moved(center if where == "middle" else center + 60 * along)
    assert scene.translation[1] == pytest.approx(0, abs=1e-9)
    picture = scene.picture(0.05)
    with pytest.raises(DegenerateError, match=r"Ty = 0.*move the origin"):
        calibrate_coplanar(scene.sheet, picture, scene.camera)
    for method in (tsai_polish, calibrate_full):
        result = method(scene.sheet, picture, scene.camera)
        assert result.translation_mm == pytest.approx(scene.translation, rel=0.02, abs=1.5)


def test_every_refusal_is_one_line_with_a_remedy():
    scene = Scene(tilt_deg=(0.0, 0.0))
    with pytest.raises(DegenerateError) as caught:
        calibrate_coplanar(scene.sheet, scene.picture(), scene.camera)
    assert "\n" not in str(caught.value)
    assert "tilt the camera" in str(caught.value)


# What is said of it


def test_the_answer_as_json():
    scene = Scene()
    answer = json.loads(json.dumps(calibrate_full(scene.sheet, scene.picture(0.05), scene.camera).to_dict()))
    assert list(answer) == [
        "method", "focal_length_mm", "kappa1_per_mm2", "translation_mm", "rotation", "angles_deg", "sx",
        "principal_point_px", "tz_over_f", "sum_of_squares_px2", "points",
    ]  # fmt: skip
    assert answer["method"] == "full"
    assert answer["points"] == 168
    assert answer["tz_over_f"] == answer["translation_mm"][2] / answer["focal_length_mm"]
    assert np.shape(answer["rotation"]) == (3, 3)
    assert answer["sum_of_squares_px2"] == pytest.approx(2 * 168 * 0.05**2, rel=0.2)


def test_the_report_reads_as_the_papers():
    """Figure 9 of the paper, whose figures are put in."""
    rotation = turned(6.8499, -0.7999, -0.3396)
    camera = Camera((640, 480), (PITCH, PITCH), 18.779356, TsaiLens(-2.490561e-3), (320.160160, 318.300075))
    lines = (
        TsaiResult("tsai", camera, rotation, np.array([-85.1819, -74.189, 1062.7438]), 2.0, 100).report().splitlines()
    )
    assert lines[:6] == [
        "Coplanar calibration (Tz, f, kappa1 optimization)",
        "",
        "f = 18.779356 [mm]",
        "kappa1 = -2.490561e-03 [1/mm^2]",
        "Tx = -85.181900, Ty = -74.189000, Tz = 1062.743800 [mm]",
        "Rx = 6.849900, Ry = -0.799900, Rz = -0.339600 [deg]",
    ]
    assert lines[6] == "R"
    assert [float(v) for v in lines[8].split()] == pytest.approx([-0.005926, 0.992854, -0.119184], abs=2e-6)
    assert lines[10:13] == ["sx = 1.000000", "Cx = 320.160160, Cy = 318.300075 [pixels]", "Tz / f = 56.591067"]
    assert "residual = 0.1 [pixels rms per axis]" in lines[14]


def test_what_is_doubtful_is_said():
    scene = Scene(tilt_deg=(2.0, 1.0), mirrored=True)
    picture = scene.picture(0.1)
    picture[16] += 3.0
    result = tsai_polish(scene.sheet, picture, scene.camera)
    assert [doubt.split()[0] for doubt in result.doubts] == ["f", "point", "the"]
    assert "point 17 lies 4." in result.doubts[1]
    assert result.report().count("note: ") == 3


def test_a_sound_answer_comes_without_doubts():
    scene = Scene(tilt_deg=(15.0, 9.0), kappa1=2e-3)
    assert [m(scene.sheet, scene.picture(0.05), scene.camera).doubts for m in METHODS] == [()] * 3
