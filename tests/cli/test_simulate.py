import json

import pytest

from drivers.replay import ReplayGrabber
from service.cli import main
from service.config.cameras import read_camera


def test_a_video_comes_with_its_truth_and_its_camera(tmp_path, capsys):
    out = tmp_path / "bowl.mkv"
    assert main(["simulate", str(out), "--generator", "candu6", "--seed", "3", "--frames", "3"]) == 0
    assert capsys.readouterr().out.startswith(f"{out}: 3 frames")
    truth = json.loads((tmp_path / "bowl.json").read_text())
    camera = read_camera(tmp_path / "bowl.camera.toml")
    assert (truth["model"], len(truth["frames"])) == ("CANDU6", 3)
    assert camera.focal_length_mm == pytest.approx(truth["camera"]["focal_mm"])
    assert camera.complete
    with ReplayGrabber(out, speed=1000) as grabber:
        assert (grabber.format.width_px, grabber.format.height_px) == camera.image_size_px
        assert len(list(grabber.start())) == 3


def test_another_seed_is_another_video(tmp_path):
    truths = []
    for seed in ("1", "1", "2"):
        main(["simulate", str(tmp_path / "a.mkv"), "--generator", "51b", "--seed", seed, "--frames", "1"])
        truths.append((tmp_path / "a.json").read_text())
    assert truths[0] == truths[1] != truths[2]


def test_a_generator_of_ones_own_can_be_rendered(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text('[mine]\narrangement = "rotated-square"\npitch_mm = 20\ntube_outer_diameter_mm = 12\nwall_mm = 1\n')
    assert main(["simulate", str(tmp_path / "a.nut"), "--generator", str(mine), "--frames", "1"]) == 0
    assert json.loads((tmp_path / "a.json").read_text())["model"] == "mine"


@pytest.mark.parametrize(
    ("out", "generator", "words"),
    [
        ("bowl.mp4", "51b", "unknown ending '.mp4'; use .mkv"),
        ("gone/bowl.mkv", "51b", "gone/bowl.mkv: cannot be written: No such file or directory"),
        ("bowl.mkv", "52b", "did you mean 51b?"),
        ("bowl.mkv", "fat.toml", "cannot be rendered"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, out, generator, words):
    monkeypatch.chdir(tmp_path)
    fat = '[fat]\narrangement = "square"\npitch_mm = 20\ntube_outer_diameter_mm = 19.9\nwall_mm = 0.1\n'
    (tmp_path / "fat.toml").write_text(fat)
    assert main(["simulate", out, "--generator", generator, "--frames", "1"]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["fat.toml"]
