from dataclasses import replace

import numpy as np
import pytest

from service.alignment.geometry import guide_foot
from service.cli import main
from service.config.generators import load_generator
from service.config.guide import read_guide
from service.vision.measurement import Doubt, Lock
from service.vision.projection import project
from tests.alignment.scenes import CAMERA
from tests.alignment.test_setup import PLAY_MM, TRUE_AXIS, TRUE_POINT, stood
from tests.fakes.results import make_measurement

CAMERA_FILE = "image_size_px = [64, 48]\npixel_pitch_mm = [0.005, 0.005]\n"
STATION = """[source]
device = "bowl.mp4"
[generator]
name = "system80"
[identity]
rows_grow = "right"
columns_grow = "up"
"""
TUBE_MM = 2 * load_generator("system80").lattice.rim_radius_mm
ROD = ["--probe-diameter-mm", str(TUBE_MM - 2 * PLAY_MM)]
AT = project(CAMERA.vector(), np.eye(3), np.zeros(3), (TRUE_POINT + 50 * TRUE_AXIS / TRUE_AXIS[2])[None])[0]
OVER = [f"--guide-px={AT[0]:.0f},{AT[1]:.0f}"]


@pytest.fixture
def seen(vision, monkeypatch):
    """Put measurements into vision's mouth, one a frame."""
    monkeypatch.setattr("service.cli.align_setup.Measurer", vision)
    monkeypatch.setattr("service.cli.align_setup.prepare_kernels", lambda: None)

    def show(measurements):
        coming = iter(measurements)
        vision.answer = lambda: [next(coming)]

    return show


@pytest.fixture
def setup(seen, video, tmp_path, capsys):
    """Run `align-setup` over these measurements; gives status, the guide read back (or None), and what was said."""

    def run(measurements, *options, out="guide.toml"):
        seen(measurements)
        (tmp_path / "camera.toml").write_text(CAMERA_FILE)
        path = video(frames=len(measurements))
        files = ["--camera", str(tmp_path / "camera.toml"), "--out", str(tmp_path / out)]
        status = main(["align-setup", str(path), "--generator", "system80", *files, *map(str, options)])
        output, words = capsys.readouterr()
        guide = read_guide(tmp_path / out) if (tmp_path / out).exists() and out == "guide.toml" else None
        return status, guide, output + words

    return run


def standings(count, **how):
    rng = np.random.default_rng(5)
    made = [stood(rng, inserted_mm=60.0, **how) for _ in range(count)]
    return [m for ms, _ in made for m in ms], [place for _, place in made]


def check(guide):
    """Within three sigmas of the truth, across the axis."""
    at = TRUE_POINT + TRUE_AXIS * ((guide.point_mm - TRUE_POINT) @ TRUE_AXIS)
    across = np.linalg.svd(guide.direction[None])[2][1:]
    sigma = np.sqrt(np.diag(across @ guide.covariance[3:, 3:] @ across.T))
    assert (np.abs(across @ (guide.point_mm - at)) < 3 * sigma).all()
    turn = across @ np.cross(TRUE_AXIS, guide.direction)
    assert (np.abs(turn) < 3 * np.sqrt(np.diag(across @ guide.covariance[:3, :3] @ across.T))).all()
    assert (sigma < 0.3).all()


def test_the_nearest_tube_to_where_the_guide_points_is_taken(setup):
    measurements, _ = standings(4, pictures=3)
    status, guide, said = setup(measurements, *ROD, *OVER, "--inserted-mm", 60, "--gap-mm", 20)
    assert status == 0
    check(guide)
    assert guide.at_mouth
    assert said.count("3 pictures, 60 mm inserted") == 4
    assert '[alignment] guide = "guide.toml"' in said


def test_a_table_says_which_tube_which_frames_and_how_deep(setup, tmp_path):
    measurements, places = standings(3, pictures=2)
    nothing = [make_measurement(Lock.NONE)] * 2
    lines = [f"{3 * k}-{3 * k + 1} {row},{column} 60" for k, (row, column) in enumerate(places)]
    (tmp_path / "table").write_text("# frames tube mm\n\n" + "\n".join(lines))
    frames = [m for k in range(3) for m in (*measurements[2 * k : 2 * k + 2], nothing[0])]
    status, guide, said = setup(frames, *ROD, "--table", tmp_path / "table")
    assert status == 0
    check(guide)
    assert not guide.at_mouth
    assert "must give gap_mm" in said
    assert f"frames 0-1, tube {places[0][0]},{places[0][1]}: 2 pictures" in said


def test_a_table_may_name_the_tubes_where_one_is_anchored(setup, tmp_path):
    measurements, ((row, column), *_) = standings(1)
    (tmp_path / "table").write_text("0 L83R87 60\n")
    (tmp_path / "station.toml").write_text(STATION)
    more = ["--config", tmp_path / "station.toml", "--anchor", f"{row},{column}=L83R87"]
    status, guide, said = setup(measurements, *ROD, "--table", tmp_path / "table", *more)
    assert status == 0, said
    assert guide is not None


def test_a_named_tube_without_an_anchor_is_not_guessed_at(setup, tmp_path):
    measurements, _ = standings(1)
    (tmp_path / "table").write_text("0 L83R87 60\n")
    status, guide, said = setup(measurements, *ROD, "--table", tmp_path / "table")
    assert (status, guide) == (2, None)
    assert "no anchor names it; give --anchor" in said


def test_one_frame_leaves_the_direction_unknown_and_writes_nothing(setup):
    measurements, _ = standings(1)
    status, guide, said = setup(measurements, *ROD, *OVER)
    assert (status, guide) == (1, None)
    assert "direction is known to 15.0 deg only" in said
    assert "--inserted-mm" in said


def test_a_guide_known_too_badly_to_judge_by_is_written_and_said(setup):
    measurements, _ = standings(1)
    status, guide, said = setup(measurements, *ROD, *OVER, "--inserted-mm", 35)
    assert status == 0
    assert guide is not None
    assert "tilt will not be judged" in said


def test_pictures_without_a_lock_are_left_out_and_counted(setup):
    measurements, _ = standings(2)
    frames = [*measurements, make_measurement(Lock.NONE, reason="too dark")]
    status, _, said = setup(frames, *ROD, *OVER, "--inserted-mm", 60)
    assert status == 0
    assert "1 picture left out: no lock: too dark" in said
    status, _, said = setup([make_measurement(Lock.NONE)], *ROD, *OVER, out="other.toml")
    assert status == 1
    assert "no picture shows the guide" in said


def test_a_line_of_the_table_without_a_picture_is_named(setup, tmp_path):
    measurements, ((row, column), *_) = standings(1)
    (tmp_path / "table").write_text(f"0 {row},{column} 60\n7-9 {row},{column} 60\n")
    status, guide, said = setup(measurements, *ROD, "--table", tmp_path / "table")
    assert (status, guide) == (1, None)
    assert "frames 7-9: no picture" in said


def test_a_place_is_not_trusted_while_the_index_is_in_doubt(setup, tmp_path):
    measurements, ((row, column), *_) = standings(1)
    (tmp_path / "table").write_text(f"0 {row},{column} 60\n")
    doubtful = [replace(m, lock=Lock.PARTIAL, doubt=(Doubt.INDEX,)) for m in measurements]
    status, _, said = setup(doubtful, *ROD, "--table", tmp_path / "table")
    assert status == 1
    assert "index is in doubt" in said


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (OVER, ["--probe-diameter-mm"]),
        (ROD, ["--guide-px", "--table"]),
        ([*OVER, "--probe-diameter-mm", "20"], ["--probe-diameter-mm 20", "16.92"]),
        ([*ROD, "--guide-px", "3"], ["'' is no number"]),
        ([*ROD, "--guide-px", "nan,3"], ["X,Y in pixels"]),
        ([*ROD, "--table", "none"], ["none: cannot be read"]),
        ([*ROD, *OVER, "--inserted-mm", "-3"], ["-3", "above 0"]),
        ([*ROD, *OVER, "--anchor", "3"], ["ROW,COLUMN=NAME"]),
    ],
)
def test_wrong_use_is_said_in_one_line_before_anything_is_measured(setup, vision, options, words):
    measurements, _ = standings(1)
    status, guide, said = setup(measurements, *options)
    assert (status, guide, vision.made) == (2, None, [])
    for word in words:
        assert word in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", ["no standing in it"]),
        ("0", ["table:1", "'0'", "FRAMES TUBE"]),
        ("x 3,4", ["table:1", "'x 3,4'"]),
        ("9-3 3,4", ["table:1", "before the first"]),
        ("0-4 3,4\n4 3,5", ["table:2", "frame 4 belong to frames 0-4 already"]),
        ("0 L83R88", ["table:1", "must be even"]),
        ("0 nearest", ["--guide-px"]),
    ],
)
def test_a_table_that_says_nothing_sound_is_refused_by_line(setup, tmp_path, vision, table, words):
    (tmp_path / "table").write_text(table)
    status, _, said = setup(standings(1)[0], *ROD, "--table", tmp_path / "table")
    assert (status, vision.made) == (2, [])
    for word in words:
        assert word in said


def test_what_is_read_is_not_written_over(setup, tmp_path):
    status, _, said = setup(standings(1)[0], *ROD, *OVER, out="camera.toml")
    assert status == 2
    assert "choose another name" in said
    assert (tmp_path / "camera.toml").read_text() == CAMERA_FILE


def test_the_guide_written_points_where_the_true_one_does(setup):
    measurements, _ = standings(6)
    _, guide, _ = setup(measurements, *ROD, *OVER, "--inserted-mm", 60)
    for m in measurements:
        R, t = m.pose.rotation, m.pose.translation_mm
        p, d = R.T @ (TRUE_POINT - t), R.T @ TRUE_AXIS
        assert guide_foot(m.pose, guide) == pytest.approx(p[:2] - d[:2] * p[2] / d[2], abs=0.5)
