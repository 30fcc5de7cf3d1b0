"""The rendered scene is where its truth says, to a few thousandths of a pixel."""

import errno
import json
import math
from dataclasses import replace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from drivers.errors import ConfigError
from drivers.optics import Optics
from drivers.rendering import Renderer, add_noise, quantised
from drivers.replay import ReplayGrabber
from drivers.scene import (
    ABSENT,
    CLEAN,
    GENERATORS,
    HARD,
    LOOKS,
    NOMINAL,
    OPEN,
    PLUGGED,
    Look,
    Sheet,
    TubeLattice,
    make_sheet,
)
from drivers.simulated_video import render_video, scene_truth
from drivers.simulation import Scene, default_scene
from service.config.generators import generator_names, load_generator

BARE = Look(
    plate=0.6, rim=0.6, weld_mm=0.0, texture=0.0, wall=0.0, ambient=1.0, spot=math.inf, glare=0.0, blur_px=0.0,
    read_noise=0.0, shot_noise=0.0, specks=0.0, hose=False,
)  # fmt: skip
TSAI = Optics(320, 240, 6.0, (0.0056, 0.0056), (158.2, 121.7), kappa1_per_mm2=0.02)
BARREL = Optics(320, 240, 3.0, (0.0056, 0.006), (161.0, 118.0), opencv_distortion=(-0.25, 0.05, 1e-3, -5e-4, 0.0))


def pose(tilt_deg, distance_mm=550.0, azimuth_deg=35.0, roll_deg=20.0):
    """Camera looking at the sheet's origin."""
    axis = np.array([math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg)), 0])
    rotation = (
        cv2.Rodrigues(np.array([0, 0, math.radians(roll_deg)]))[0] @ cv2.Rodrigues(axis * math.radians(tilt_deg))[0]
    )
    return rotation, np.array([0, 0, distance_mm])


def one_tube(center_mm, lattice=GENERATORS["model-f"]):
    states = np.full((21, 21), ABSENT)
    states[10, 10] = OPEN
    centers = np.zeros((21, 21, 3))
    rows, columns = np.mgrid[-10:11, -10:11]
    centers[..., :2] = np.stack([columns, rows], axis=-1) @ lattice.basis_mm
    centers[10, 10] = center_mm
    return Sheet(lattice, (-10, -10), centers, states, np.ones((21, 21)))


def circle_centroid(optics, sheet, rotation, translation_mm, site=(10, 10)):
    """Centre of area of the rim's image, from its polygon."""
    angles = np.linspace(0, 2 * math.pi, 4000, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1) * sheet.lattice.rim_radius_mm
    p = optics.project(rotation, translation_mm, sheet.centers_mm[site] + circle)
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    return ((p + q) * cross[:, None]).sum(axis=0) / (3 * cross.sum()), abs(cross.sum()) / 2


@pytest.mark.parametrize("blur_px", [0.0, 0.9])
@pytest.mark.parametrize("tilt_deg", [0.0, 7.0, 30.0])
@pytest.mark.parametrize("optics", [TSAI, BARREL], ids=["tsai", "opencv"])
@pytest.mark.parametrize("center_mm", [(0.3, -0.2, 0.0), (-3.0, 2.0, 4.0), (2.5, 3.5, -2.0)])
def test_a_disc_lies_where_the_circle_projects(optics, tilt_deg, blur_px, center_mm):
    sheet = one_tube(center_mm)
    rotation, translation = pose(tilt_deg)
    image = Renderer(optics, sheet, replace(BARE, blur_px=blur_px), np.random.default_rng(0)).draw(
        rotation, translation
    )
    dark = 1 - image.astype(np.float64) / 0.6
    v, u = np.mgrid[: optics.height_px, : optics.width_px]
    found = np.array([(dark * u).sum(), (dark * v).sum()]) / dark.sum()
    expected, area = circle_centroid(optics, sheet, rotation, translation)
    assert found == pytest.approx(expected, abs=0.005)
    assert math.sqrt(dark.sum() / area) == pytest.approx(1, abs=0.002)


def test_scattered_tubes_are_drawn_where_they_really_are():
    lattice = GENERATORS["system80"]
    sheet = make_sheet(
        lattice,
        (-4, -4),
        (9, 9),
        replace(BARE, scatter_mm=0.5, plugged=0.0, absent=0.0, lane_rows=0),
        np.random.default_rng(3),
    )
    rotation, translation = pose(10.0)
    optics = replace(TSAI, width_px=400, height_px=400, principal_point_px=(200.0, 200.0))
    dark = (
        1 - Renderer(optics, sheet, BARE, np.random.default_rng(0)).draw(rotation, translation).astype(np.float64) / 0.6
    )
    radius = int(0.45 * lattice.pitch_mm * 6.0 / 0.0056 / 550)
    for i, j in np.ndindex(9, 9):
        (x, y) = optics.project(rotation, translation, sheet.centers_mm[i, j])
        left, top = round(x) - radius, round(y) - radius
        if min(left, top) < 0 or max(left, top) + 2 * radius > 399:
            continue
        v, u = np.mgrid[top : top + 2 * radius + 1, left : left + 2 * radius + 1]
        near = (u - x) ** 2 + (v - y) ** 2 < radius**2
        part = dark[top : top + 2 * radius + 1, left : left + 2 * radius + 1] * near
        found = np.array([(part * u).sum(), (part * v).sum()]) / part.sum()
        expected, _ = circle_centroid(optics, sheet, rotation, translation, (i, j))
        assert found == pytest.approx(expected, abs=0.005)


def test_odd_rows_of_an_interlaced_picture_are_exposed_half_a_frame_later():
    def way(time_s):
        rotation, translation = pose(0.0)
        return rotation, translation + np.array([2000 * time_s, 0, 0])

    scene = Scene(
        TSAI, one_tube((0, 0, 0)), BARE, way, rate_hz=25, interlaced=True, bits=16, rng=np.random.default_rng(0)
    )
    dark = 1 - scene.picture(0) / (0.6 * 65535)
    u = np.arange(TSAI.width_px)
    even, odd = ((rows * u).sum() / rows.sum() for rows in (dark[::2], dark[1::2]))
    fields = [scene.optics.project(*scene.pose(0, odd_field=f), np.zeros(3))[0] for f in (False, True)]
    assert odd - even == pytest.approx(fields[1] - fields[0], abs=0.05)
    assert fields[1] - fields[0] == pytest.approx(2000 * 0.02 * 6.0 / 0.0056 / 550, abs=0.5)  # 20 ms at 2 m/s


def test_the_lens_models_agree_with_their_own_inverse():
    u, v = np.meshgrid(np.linspace(0, 319, 9), np.linspace(0, 239, 7))
    points = np.stack([u, v], axis=-1)
    for optics in (TSAI, BARREL, replace(TSAI, kappa1_per_mm2=-0.02)):
        rays = np.insert(optics.undistort(points), 2, 1.0, axis=-1)
        np.testing.assert_allclose(optics.project(np.eye(3), np.zeros(3), rays * 700), points, atol=1e-6)


def test_beyond_the_lens_fold_and_behind_the_camera_nothing_is_imaged():
    optics = Optics(320, 240, 2.0, (0.0056, 0.0056), (160, 120), opencv_distortion=(-0.5, 0.0, 0.0, 0.0, 0.0))
    points = optics.project(np.eye(3), np.zeros(3), np.array([[100.0, 0, 100], [10, 0, -100], [10, 0, 100]]))
    assert np.isnan(points[:2]).all()
    assert np.isfinite(points[2]).all()
    strong = replace(optics, opencv_distortion=None, kappa1_per_mm2=-0.6)
    assert np.isnan(strong.rays()).any()
    image = Renderer(strong, one_tube((0, 0, 0)), BARE, np.random.default_rng(0)).draw(*pose(0.0))
    assert np.isfinite(image).all()
    assert (image[np.isnan(strong.rays()[..., 0])] == 0).all()


# -- what is drawn -----------------------------------------------------------------------------------------------------


def level_at(scene, index, radius_mm=0.0, number=0):
    """Mean grey at a tube's axis, or on a circle about it, without noise."""
    angles = np.linspace(0, 2 * math.pi, 16, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1) * radius_mm
    points = scene.optics.project(*scene.pose(number), scene.sheet.centers_mm.reshape(-1, 3)[index] + circle)
    image = scene._renderer.draw(*scene.pose(number))
    return np.mean([cv2.getRectSubPix(image, (1, 1), tuple(map(float, p)))[0, 0] for p in points])


def test_open_plugged_and_absent_places_look_as_they_should():
    look = replace(BARE, rim=0.9, plug=0.7, plugged=0.2, absent=0.2, lane_rows=2, scatter_mm=0.05)
    scene = default_scene(GENERATORS["delta60"], np.random.default_rng(4), frames=4, look=look)
    seen = {}
    for index, visible in zip(*(scene.tubes_in_view(0)[i] for i in (0, 2)), strict=True):
        if visible == 1:
            seen.setdefault(int(scene.sheet.states.ravel()[index]), []).append(index)
    middle = (scene.sheet.lattice.rim_radius_mm + scene.sheet.lattice.outer_radius_mm) / 2
    assert level_at(scene, seen[OPEN][0]) == pytest.approx(0, abs=0.01)
    assert level_at(scene, seen[OPEN][0], middle) > 0.7
    assert level_at(scene, seen[PLUGGED][0]) > 0.5
    assert ABSENT not in seen
    states = scene.sheet.states
    assert any((states[i] == ABSENT).all() and (states[i + 1] == ABSENT).all() for i in range(len(states) - 1))


def test_the_lit_wall_darkens_with_depth_and_is_seen_aslant_only():
    sheet = one_tube((0, 0, 0))
    image = Renderer(TSAI, sheet, replace(BARE, wall=0.5), np.random.default_rng(0)).draw(*pose(25.0, distance_mm=200))
    u, v = TSAI.project(*pose(25.0, distance_mm=200), np.zeros(3))
    inside = image[round(v) - 20 : round(v) + 21, round(u) - 20 : round(u) + 21]
    assert inside.max() > 0.1
    assert inside.min() < 0.02


def test_light_glare_hose_noise_and_specks_are_there():
    rng = np.random.default_rng(0)
    scene = default_scene(GENERATORS["candu6"], rng, frames=4, look=replace(HARD, plugged=0.0, absent=0.0, lane_rows=0))
    image = scene._renderer.draw(*scene.pose(0))
    cover = scene._renderer.hose_cover(*scene.pose(0))
    covered = cv2.erode(cover, np.ones((9, 9))) == 255
    assert image[covered].max() < 0.1 < image[cover == 0].max()
    dull = default_scene(GENERATORS["candu6"], np.random.default_rng(0), frames=4, look=replace(HARD, glare=0.0))
    assert image.mean() > dull._renderer.draw(*dull.pose(0)).mean()
    grey = np.full((200, 200), 0.5, np.float32)
    noisy = add_noise(grey, Look(read_noise=2.0, shot_noise=4.0, specks=0.0), np.random.default_rng(1))
    assert noisy.std() * 255 == pytest.approx(math.hypot(2.0, 4.0 * math.sqrt(0.5)), rel=0.03)
    speckled = add_noise(grey.copy(), Look(read_noise=0, shot_noise=0, specks=30.0), np.random.default_rng(1))
    assert 15 < (speckled != 0.5).sum() < 400


def test_grey_values_fill_both_depths():
    ramp = np.array([[-0.5, 0, 0.5, 1, 2]], np.float32)
    assert quantised(ramp, 8).tolist() == [[0, 0, 128, 255, 255]]
    assert quantised(ramp, 16).tolist() == [[0, 0, 32768, 65535, 65535]]


def test_the_same_seed_draws_the_same_pictures_in_any_order():
    def scene():
        return default_scene(GENERATORS["51b"], np.random.default_rng(11), size_px=(160, 120), frames=5)

    a, b = scene(), scene()
    late = b.picture(3)
    for number in range(4):
        np.testing.assert_array_equal(a.picture(number), late if number == 3 else b.picture(number))
    other = default_scene(GENERATORS["51b"], np.random.default_rng(12), size_px=(160, 120), frames=5)
    assert not np.array_equal(other.picture(3), late)


def test_tubes_that_the_renderer_cannot_draw_are_refused():
    with pytest.raises(ValueError, match="arrangement"):
        TubeLattice("hexagonal", 25, 8, 9)
    with pytest.raises(ValueError, match="outer_radius_mm"):
        TubeLattice("square", 20, 8, 9)


@pytest.mark.parametrize("arrangement", ["triangular", "rotated-triangular", "square", "rotated-square"])
def test_every_arrangement_is_seen_whole(arrangement):
    scene = default_scene(
        TubeLattice(arrangement, 25.0, 7.5, 9.0), np.random.default_rng(2), frames=6, look=replace(CLEAN, plugged=0)
    )
    for number in (0, 3, 6):
        index, px, visible = scene.tubes_in_view(number)
        pitch_px = np.median([np.sort(np.linalg.norm(px - p, axis=1))[1] for p in px])
        cells = 640 * 480 / (pitch_px**2 * (math.sqrt(3) / 2 if "triangular" in arrangement else 1))
        assert (visible > 0.5).sum() == pytest.approx(cells, rel=0.15)
        assert len(set(index)) == len(index)


# -- trajectory --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_the_default_way_is_smooth_slow_enough_and_at_the_distances_of_the_job(seed):
    scene = default_scene(GENERATORS["model-f"], np.random.default_rng(seed), frames=40, look=CLEAN)
    before = None
    for number in range(81):
        rotation, translation = scene.pose(number)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert 550 < rotation[:, 2] @ translation < 1500
        assert math.degrees(math.acos(rotation[2, 2])) < 35
        px = scene.optics.project(rotation, translation, scene.sheet.centers_mm[10, 10])
        if before is not None:
            assert np.linalg.norm(px - before) < 0.3 * 60
        before = px
    for a, b in zip(scene.pose(0), scene.pose(80), strict=True):  # there and back
        np.testing.assert_allclose(a, b, atol=1e-9)


# -- truth files -------------------------------------------------------------------------------------------------------


def test_the_shipped_generators_are_those_of_the_configuration():
    assert list(GENERATORS) == generator_names()
    for name, mine in GENERATORS.items():
        theirs = load_generator(name).lattice
        assert mine.arrangement == theirs.arrangement
        for key in ("pitch_mm", "rim_radius_mm", "outer_radius_mm"):
            assert getattr(mine, key) == pytest.approx(getattr(theirs, key), abs=1e-9)


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize("name", ["a.mkv", "a.nut", "a.avi"])
def test_a_rendered_video_plays_back_to_the_last_bit_and_has_its_truth_beside_it(tmp_path, name, interlaced):
    def scene():
        return default_scene(
            GENERATORS["system80"], np.random.default_rng(5), size_px=(160, 120), frames=6, interlaced=interlaced
        )

    steps = []
    truth_path = render_video(scene(), tmp_path / name, 6, progress=lambda done, total: steps.append((done, total)))
    assert steps == [(i, 6) for i in range(1, 7)]
    assert {p.name for p in tmp_path.iterdir()} == {"a.json", name}
    again = scene()
    with ReplayGrabber(tmp_path / name, speed=math.inf) as grabber:
        grabber.start()
        for number, frame in enumerate(grabber):
            np.testing.assert_array_equal(frame.pixels, again.picture(number))
            assert frame.defect is None
    assert number == 5
    truth = json.loads(truth_path.read_text())
    assert (truth["n_frames"], truth["video"], truth["model"], truth["interlaced"]) == (6, name, "System80", interlaced)
    for number, frame in enumerate(truth["frames"]):
        rotation, translation = again.pose(number)
        np.testing.assert_allclose(frame["R"], rotation, atol=1e-8)
        np.testing.assert_allclose(frame["t"], translation, atol=1e-4)
        assert ("R_odd_field" in frame) is interlaced
        px = np.reshape(frame["px"], (-1, 2))
        actual = np.array([truth["tubes"][i]["xyz_actual"] for i in frame["tube_index"]])
        np.testing.assert_allclose(again.optics.project(rotation, translation, actual), px, atol=2e-3)
        assert len(frame["vis"]) == len(px)


def test_truth_has_every_key_of_the_truth_data(shared):
    theirs = json.loads((shared / "bowl" / "videos" / "v0_WF_nominal_pan_640x480.json").read_text())
    scene = default_scene(GENERATORS["model-f"], np.random.default_rng(0), size_px=(160, 120), frames=2)
    mine = scene_truth(scene, 2, name="x", video="x.mkv")
    of_their_renderer = {"seed", "codec", "exposure_fraction", "sensor"}
    assert set(theirs) - set(mine) == of_their_renderer
    assert set(theirs["camera"]) == set(mine["camera"])
    assert set(theirs["tubes"][0]) == set(mine["tubes"][0])
    assert set(theirs["frames"][0]) - set(mine["frames"][0]) == {"gain", "probe_tip_px"}


def test_the_forward_model_reproduces_the_truth_data(shared):
    for path in sorted((shared / "bowl" / "stills").glob("*.json"))[::4]:
        truth = json.loads(path.read_text())
        camera, lens = truth["camera"], truth["camera"]["distortion"]
        optics = Optics(
            camera["width"], camera["height"], camera["focal_mm"], tuple(camera["pixel_mm"]),
            (camera["K"][0][2], camera["K"][1][2]), lens.get("kappa1_per_mm2") or 0.0, lens.get("coeffs"),
        )  # fmt: skip
        actual = np.array([t["xyz_actual"] for t in truth["tubes"]])
        px = optics.project(np.array(camera["R"]), np.array(camera["t"]), actual)
        np.testing.assert_allclose(px, [t["px"] for t in truth["tubes"]], atol=5e-3)


@pytest.mark.parametrize(("name", "words"), [("a.mp4", "use .mkv, .avi, .nut"), ("gone/a.mkv", "cannot be written")])
def test_a_video_that_cannot_be_written_is_refused_in_a_line(tmp_path, name, words):
    scene = default_scene(GENERATORS["system80"], np.random.default_rng(5), size_px=(64, 48), frames=2)
    with pytest.raises(ConfigError) as error:
        render_video(scene, tmp_path / name, 2)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fails", ["_write_video", "scene_truth"])
def test_a_rendering_that_finds_no_room_leaves_the_one_before_as_it_was(tmp_path, monkeypatch, fails):
    scene = default_scene(GENERATORS["system80"], np.random.default_rng(5), size_px=(64, 48), frames=2)
    render_video(scene, tmp_path / "a.mkv", 2)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    monkeypatch.setattr(f"drivers.simulated_video.{fails}", Mock(side_effect=OSError(errno.ENOSPC, "No space left")))
    with pytest.raises(ConfigError, match=r"a\.mkv: cannot be written: No space left"):
        render_video(scene, tmp_path / "a.mkv", 2)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert set(before) == {"a.mkv", "a.json"}


def test_an_interrupted_rendering_leaves_nothing_behind(tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    scene = default_scene(GENERATORS["system80"], np.random.default_rng(5), size_px=(64, 48), frames=2)
    with pytest.raises(KeyboardInterrupt):
        render_video(scene, tmp_path / "a.mkv", 2, progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_the_looks_differ_as_their_names_say():
    assert LOOKS["nominal"] is NOMINAL
    assert CLEAN.read_noise < NOMINAL.read_noise < HARD.read_noise
    assert CLEAN.ambient > NOMINAL.ambient > HARD.ambient
