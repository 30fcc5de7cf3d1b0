"""--anchor, --target and the station's guide, through the commands."""

import json

import pytest

from service.cli import main
from service.vision.measurement import Lock
from tests.fakes.results import make_measurement

CAMERA = "image_size_px = [64, 48]\npixel_pitch_mm = [0.005, 0.005]\n"
STATION = """[source]
device = "bowl.mp4"
[generator]
name = "model-f"
[identity]
rows_grow = "up"
columns_grow = "right"
"""
ALIGNED = STATION + '[alignment]\nguide = "guide.toml"\nprobe_diameter_mm = 15\n'
GUIDE = "mouth_mm = [0, 0, 980]\naxis = [0, 0, 1]\naxis_sigma_deg = 0.01\npoint_sigma_mm = 0.01\n"


@pytest.fixture
def station(tmp_path):
    def write(text):
        (tmp_path / "guide.toml").write_text(GUIDE)
        (tmp_path / "station.toml").write_text(text)
        return tmp_path / "station.toml"

    return write


@pytest.fixture
def analyze(vision, capsys):
    vision.answer = lambda: [make_measurement(tilt_deg=0.0)]

    def run(*arguments):
        status = main(["analyze", *map(str, arguments), "--generator", "model-f", "--jsonl", "-"])
        output, words = capsys.readouterr()
        return status, [json.loads(line) for line in output.splitlines() if line.startswith("{")], words

    return run


def test_without_a_guide_or_anchor_nothing_is_said(analyze, picture, station):
    for more in ([], ["--config", station(STATION)]):
        _, (line,), _ = analyze(picture(), *more)
        assert line["alignment"] is None
        assert {tube["name"] for tube in line["tubes"]} == {None}


def test_an_anchor_names_the_tubes(analyze, picture, station):
    _, (line,), _ = analyze(picture(), "--config", station(STATION), "--anchor", "0,0=R30C60")
    assert [tube["name"] for tube in line["tubes"]] == [f"ROW{30 - k} COL60" for k in range(5)]
    assert line["alignment"] is None


def test_a_place_may_be_negative(analyze, picture, station):
    _, (line,), _ = analyze(picture(), "--config", station(STATION), "--anchor", "-1,-2=R30C60")
    assert line["tubes"][0]["name"] == "ROW29 COL62"
    status, _, words = analyze(picture(), "--config", station(ALIGNED), "--target", "-1,0")
    assert (status, "usage" in words) == (0, False)


def test_a_guide_is_aligned_to_the_nearest_tube_or_the_one_named(analyze, picture, station):
    _, (line,), _ = analyze(picture(), "--config", station(ALIGNED))
    assert (line["alignment"]["target"], line["alignment"]["place"]) == ("nearest", [0, 0])
    options = ["--config", station(ALIGNED), "--anchor", "0,0=R30C60", "--target", "30/60"]
    _, (line,), _ = analyze(picture(), *options)
    assert (line["alignment"]["target"], line["alignment"]["place"]) == ("ROW30 COL60", [0, 0])


def test_the_stations_target_holds_where_none_is_given(analyze, picture, station):
    _, (line,), _ = analyze(picture(), "--config", station(ALIGNED + 'target = "1,0"\n'))
    assert line["alignment"]["place"] == [1, 0]


def test_no_lock_is_a_verdict_too(analyze, picture, station, vision):
    vision.answer = lambda: [make_measurement(Lock.NONE, reason="too dark")]
    _, (line,), _ = analyze(picture(), "--config", station(ALIGNED))
    assert line["alignment"]["verdict"] == "no lock"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--target", "nearest"], ["--target", "align-setup"]),
        (["--anchor", "0,0=R30C60"], ["ways to count", "rows_grow"]),
        (["--anchor", "R30C60"], ["'R30C60'", "ROW,COLUMN=NAME"]),
        (["--anchor", "0,0=L30R60"], ["'L30R60'", "ROW12 COL34"]),
        (["--config", "STATION", "--target", "L3R5"], ["'L3R5'", "ROW12 COL34"]),
        (["--config", "STATION", "--anchor", "0,0=R3C5", "--anchor", "0,1=R3C7"], ["no way to count"]),
        (["--config", "none.toml"], ["none.toml", "no such file"]),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_measured(analyze, picture, station, vision, options, words):
    status, lines, said = analyze(picture(), *[str(station(ALIGNED)) if o == "STATION" else o for o in options])
    assert (status, lines, vision.made) == (2, [], [])
    assert said.count("\n") == 1
    for word in words:
        assert word in said


@pytest.mark.parametrize("option", [["--anchor", "0,0=R30C60"], ["--target", "0,0"]])
def test_a_lattice_place_holds_for_one_source_only(analyze, picture, station, option):
    paths = [picture("a.png"), picture("b.png", seed=1)]
    status, _, words = analyze(*paths, "--config", station(ALIGNED), *option)
    assert status == 2
    assert "one PATH at a time" in words
    assert analyze(*paths, "--config", station(ALIGNED), "--target", "nearest")[0] == 0


def test_replay_takes_them_as_well(vision, video, station, capsys):
    vision.answer = lambda: [make_measurement(tilt_deg=0.0)]
    path, config = video(frames=3), station(ALIGNED)
    command = ["replay", str(path), "--speed", "max", "--no-viewer", "--config", str(config)]
    assert main([*command, "--anchor", "0,0=R30C60", "--target", "ROW30 COL60"]) == 0
    assert main([*command, "--target", "L3R5"]) == 2
    assert "L3R5" in capsys.readouterr().err
