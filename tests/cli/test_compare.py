import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from drivers.errors import ConfigError, DeviceError
from service.cli import main
from service.cli.compare import run_compare
from service.vision.camera import Camera, TsaiLens
from service.vision.measurement import Lock, Measurement, Origin, Pose, PoseSigma, Tubes, TubeState
from tests.vision.drawing import PAPER_POSE, draw_sheet, lattice_of, see, sites_of

METHODS = ["box", "box1", "centroid", "circle", "ellipse"]
T = np.array([-20.0, 10.0, 1062.74])
CAMERA = "image_size_px = [640, 480]\npixel_pitch_mm = [0.0056, 0.0056]\n"


def no_lock(pixels, lattice, camera):
    return Measurement("progressive", Lock.NONE, "nothing was looked for", (), Tubes.none(), None, 0)


def truth_of(pixels, lattice, camera):
    """An engine that knows: the drawn pose, all drawn tubes."""
    site = sites_of(6)
    px = see(lattice, site, PAPER_POSE, T)
    inside = np.all((px >= 0) & (px < camera.image_size_px), axis=1)
    n = int(inside.sum())
    tubes = Tubes(
        site[inside, 0].astype(np.int32), site[inside, 1].astype(np.int32), px[inside], np.full(n, 0.05),
        np.full(n, Origin.MEASURED, np.uint8), np.full(n, TubeState.OPEN, np.uint8),
    )  # fmt: skip
    known = Camera(camera.image_size_px, camera.pixel_pitch_mm, 18.8, TsaiLens(-0.00249), (318.0, 160.0))
    pose = Pose(PAPER_POSE, T, known, np.eye(6), PoseSigma(1.0, 0.5, 0.02, 0.1, np.inf), 0.05)
    return Measurement("progressive", Lock.FULL, None, (), tubes, pose, 0)


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "bowl.png"
    drawn = draw_sheet(lattice_of(), sites_of(6), PAPER_POSE, T) + np.random.default_rng(0).normal(0, 2, (480, 640))
    cv2.imwrite(str(path), drawn.clip(0, 255).astype(np.uint8))
    return path


@pytest.fixture
def camera(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(CAMERA)
    return path


def test_json_has_the_five_methods_and_the_modern_answer(picture, camera, capsys):
    assert run_compare(picture, "system80", camera, "-", truth_of) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document["methods"]) == METHODS
    for row in document["methods"].values():
        assert row["tz_over_f"] == pytest.approx(T[2] / 18.8, rel=0.02)
        assert row["tz_mm"] == pytest.approx(row["tz_over_f"] * row["focal_length_mm"])
        assert len(row["center_px"]) == 2
        assert row["center_held"]["center_px"] == [319.5, 239.5]
    modern = document["modern"]
    assert modern["lock"] == "full"
    assert modern["focal_length_mm"] == 18.8
    assert modern["sigma"]["focal_length_mm"] is None  # infinite: JSON has no word for it
    assert modern["sigma"]["tz_mm"] == 1.0


def test_of_an_interlaced_picture_it_says_that_the_papers_steps_take_it_whole(picture, camera, capsys):
    def of_a_field(*seen):
        return replace(truth_of(*seen), field="top")

    run_compare(picture, "system80", camera, None, of_a_field)
    assert "its top field; the paper's steps take both as one picture" in capsys.readouterr().out
    run_compare(picture, "system80", camera, None, truth_of)
    assert "take both as one picture" not in capsys.readouterr().out


def test_the_modern_tz_is_that_of_the_same_tube(picture, camera, capsys):
    run_compare(picture, "system80", camera, "-", truth_of)
    document = json.loads(capsys.readouterr().out)
    origin = np.array(document["origin_px"])
    site = sites_of(6)
    nearest = np.nanargmin(np.linalg.norm(see(lattice_of(), site, PAPER_POSE, T) - origin, axis=1))
    depth = (PAPER_POSE @ np.append(lattice_of().sheet_points(*site[nearest : nearest + 1].T)[0], 0) + T)[2]
    assert document["modern"]["tz_mm"] == pytest.approx(depth, rel=1e-9)
    assert document["methods"]["ellipse"]["tz_over_f"] == pytest.approx(document["modern"]["tz_over_f"], rel=0.01)


def test_the_table_names_units_counts_spread_and_the_finding(picture, camera, capsys):
    assert run_compare(picture, "system80", camera, None, truth_of) == 0
    said = capsys.readouterr().out
    for words in [*METHODS, "Tz/f", "f mm", "C px", "Tz mm", "tubes linked", "Spread over the methods: Tz/f", "full"]:
        assert words in said
    assert f"distance {PAPER_POSE[:, 2] @ T:.2f} +-0.50 mm, tilt 6.90 +-0.02 deg" in said
    assert "sx 1 (assumed: not in the file)" in said
    assert "the middle: not in the file" in said
    assert max(len(line) for line in said.splitlines() if ": with C" not in line) <= 140


def test_without_a_camera_file_the_assumption_is_told(picture, capsys):
    assert run_compare(picture, "system80", None, None, no_lock) == 0
    said = capsys.readouterr().out
    assert "No --camera: pixels of 5.625 x 5.625 um assumed" in said
    assert "No lock: nothing was looked for" in said


def test_a_picture_without_tubes_is_a_result_in_words_and_in_json(tmp_path, capsys):
    path = tmp_path / "dark.png"
    cv2.imwrite(str(path), np.zeros((480, 640), np.uint8))
    assert run_compare(path, "model-f", None, None, no_lock) == 0
    assert "find no lattice of tubes" in capsys.readouterr().out
    assert run_compare(path, "model-f", None, "-", no_lock) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document["methods"]) == METHODS
    assert all(row["tz_over_f"] is None and row["notes"] for row in document["methods"].values())
    assert document["modern"]["tz_over_f"] is None


def test_a_method_without_an_answer_is_marked_and_explained(tmp_path, camera, capsys):
    path = tmp_path / "few.png"
    cv2.imwrite(str(path), draw_sheet(lattice_of(), sites_of(1)[:6], PAPER_POSE, T).astype(np.uint8))
    assert run_compare(path, "system80", camera, None, no_lock) == 0
    said = capsys.readouterr().out
    assert "ellipse *" in said
    assert "ellipse: with C refined: " in said


def test_json_goes_to_a_file_whole(picture, camera, tmp_path, capsys):
    out = tmp_path / "out.json"
    assert run_compare(picture, "system80", camera, str(out), no_lock) == 0
    assert list(json.loads(out.read_text())["methods"]) == METHODS
    assert capsys.readouterr().out.startswith("Table 2")


def test_the_picture_is_never_written_over(picture, camera):
    before = picture.read_bytes()
    with pytest.raises(ConfigError, match=r"bowl\.png: is a source"):
        run_compare(picture, "system80", camera, str(picture), no_lock)
    assert picture.read_bytes() == before


def test_a_picture_too_small_for_any_sheet_is_refused(tmp_path):
    path = tmp_path / "dot.png"
    cv2.imwrite(str(path), np.zeros((1, 20), np.uint8))
    with pytest.raises(ConfigError, match=r"dot\.png: its pictures are 20x1 px; .*16x16"):
        run_compare(path, "system80", None, None, no_lock)


def test_sixteen_bit_and_colour_pictures_are_read(tmp_path, camera, capsys):
    drawn = draw_sheet(lattice_of(), sites_of(6), PAPER_POSE, T)
    for name, pixels in (
        ("deep.png", (drawn * 200).astype(np.uint16)),
        ("colour.png", np.repeat(drawn.astype(np.uint8)[:, :, None], 3, axis=2)),
    ):
        path = tmp_path / name
        cv2.imwrite(str(path), pixels)
        assert run_compare(path, "system80", camera, "-", no_lock) == 0
        assert json.loads(capsys.readouterr().out)["tubes"] > 25


def test_wrong_input_is_refused_in_one_line_that_names_it(tmp_path, picture, camera):
    other = tmp_path / "other.toml"
    other.write_text(CAMERA.replace("640", "720"))
    text = tmp_path / "text.png"
    text.write_text("no picture")
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "cut.png").write_bytes(picture.read_bytes()[:2000])
    for path, generator, file, words in (
        (tmp_path / "gone.png", "system80", None, "gone.png"),
        (tmp_path, "system80", None, str(tmp_path)),
        (text, "system80", None, "text.png"),
        (tmp_path / "empty.png", "system80", None, "empty.png"),
        (tmp_path / "cut.png", "system80", None, "cut.png"),
        (picture, "sistem80", None, "did you mean system80"),
        (picture, "system80", tmp_path / "gone.toml", "gone.toml"),
        (picture, "system80", other, "other.toml: image_size_px = [720, 480]"),
    ):
        with pytest.raises((ConfigError, DeviceError)) as error:
            run_compare(path, generator, file, "-", no_lock)
        assert words in str(error.value)
        assert "\n" not in str(error.value)
    with pytest.raises(ConfigError, match="cannot be written"):
        run_compare(picture, "system80", camera, str(tmp_path / "gone" / "x.json"), no_lock)


def test_the_command_sets_the_live_engine_beside_the_methods(tmp_path, picture, capsys):
    file = tmp_path / "camera.toml"
    file.write_text(
        f"{CAMERA}sx = 1.0\nfocal_length_mm = 18.8\nkappa1_per_mm2 = -0.00249\nprincipal_point_px = [318.0, 160.0]\n"
    )
    assert main(["compare", str(picture), "--generator", "system80", "--camera", str(file), "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    modern = document["modern"]
    assert modern["lock"] != "none"
    assert modern["distance_mm"] == pytest.approx(PAPER_POSE[:, 2] @ T, abs=2)
    assert modern["tz_over_f"] == pytest.approx(document["methods"]["ellipse"]["tz_over_f"], rel=0.01)


def test_the_command_refuses_wrong_input_with_status_2(tmp_path, capsys):
    assert main(["compare", str(tmp_path / "gone.png"), "--generator", "system80"]) == 2
    assert "gone.png" in capsys.readouterr().err
