import re
from pathlib import Path

import pytest

from drivers.errors import ConfigError
from drivers.frame import Field
from service.config.console import ConsoleSettings
from service.config.shipped import shipped_config
from service.config.station import FieldOrder, MeasuringSettings, SourceSettings, ViewerSettings, read_station
from service.vision.camera import Camera

MINIMAL = '[source]\ndevice = "bowl.mp4"\n[generator]\nname = "system80"\n'
GUIDE = "mouth_mm = [40, 0, 900]\naxis = [0, 0, 1]\naxis_sigma_deg = 0.1\npoint_sigma_mm = 0.1\n"
CAMERA = "image_size_px = [640, 480]\npixel_pitch_mm = [0.005, 0.005]\n"


def station(folder: Path, text: str):
    path = folder / "station.toml"
    path.write_text(text)
    return read_station(path)


def test_the_shipped_file_says_what_the_defaults_are():
    shipped = read_station(shipped_config("station.toml"))
    assert shipped.source == SourceSettings("simulated")
    assert shipped.generator.key == "model-f"
    assert shipped.camera is None
    assert shipped.measuring == MeasuringSettings()
    assert shipped.viewer == ViewerSettings()
    assert shipped.console == ConsoleSettings()


def test_the_shipped_file_documents_every_key_in_place(tmp_path):
    text = shipped_config("station.toml").read_text()
    everything = re.sub(r"^# (\w+ = )", r"\1", text, flags=re.MULTILINE)
    (tmp_path / "cameras").mkdir()
    (tmp_path / "cameras" / "mine.toml").write_text(CAMERA)
    (tmp_path / "guide.toml").write_text(GUIDE)
    s = station(tmp_path, everything)
    assert s.source == SourceSettings("simulated", "S-Video 1", controls={"brightness": 128, "contrast": 64})
    assert isinstance(s.camera, Camera)
    assert (s.viewer.port, s.viewer.web_port) == (9876, 9090)
    lines = everything.splitlines()
    for key in (i for i, line in enumerate(lines) if " = " in line and not line.startswith("#")):
        above = next(line for line in reversed(lines[:key]) if " = " not in line and line.strip())
        assert above.startswith("#"), lines[key]


def test_only_source_and_generator_are_needed(tmp_path):
    s = station(tmp_path, MINIMAL)
    assert (s.source.device, s.generator.key, s.camera) == (str(tmp_path / "bowl.mp4"), "system80", None)


def test_files_are_taken_from_the_stations_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    (tmp_path / "c.toml").write_text(CAMERA)
    (tmp_path / "g.toml").write_text(
        '[mine]\narrangement = "square"\npitch_mm = 20\ntube_outer_diameter_mm = 12\nwall_mm = 1\n'
    )
    s = station(tmp_path, MINIMAL.replace("system80", "g.toml") + '[camera]\nfile = "c.toml"\n')
    assert s.generator.key == "mine"
    assert s.camera.image_size_px == (640, 480)


@pytest.mark.parametrize(
    ("device", "opened"),
    [
        ("a/bowl.mp4", "FOLDER/a/bowl.mp4"),
        ("/a/bowl.mp4", "/a/bowl.mp4"),
        ("simulated", "simulated"),
        ("simulated:51b?seed=3", "simulated:51b?seed=3"),
        ("simulated.mp4", "FOLDER/simulated.mp4"),
    ],
)
def test_a_device_is_a_kind_or_a_path_from_the_files_folder(tmp_path, device, opened):
    assert station(tmp_path, MINIMAL.replace("bowl.mp4", device)).source.device == opened.replace(
        "FOLDER", str(tmp_path)
    )


@pytest.mark.parametrize(
    ("order", "field"),
    [
        ("auto", None),
        ("progressive", Field.PROGRESSIVE),
        ("top", Field.INTERLACED_TOP_FIRST),
        ("bottom", Field.INTERLACED_BOTTOM_FIRST),
    ],
)
def test_a_field_order_is_what_every_frame_is_taken_for(order, field):
    assert FieldOrder(order).field is field


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[source]", "[sauce]", ["source", "missing", "sauce"]),
        ("device =", "devise =", ["source.device", "missing", "devise"]),
        ('"bowl.mp4"', '" "', ["source.device", "must name a source"]),
        ('"bowl.mp4"', "4", ["source.device = 4", "text"]),
        ("[generator]", 'inputs = "1"\n[generator]', ["source.inputs", "did you mean input?"]),
        ("[generator]", 'standard = "ntcs"\n[generator]', ["source.standard = 'ntcs'", "did you mean ntsc?"]),
        ("[generator]", '[source.controls]\ngain = "high"\n[generator]', ["source.controls.gain", "number"]),
        (
            "[generator]",
            'lock = ["brightness"]\n[generator]',
            ["source.lock", "'brightness' is no automatic", "auto_focus"],
        ),
        ("[generator]", 'lock = "auto_focus"\n[generator]', ["source.lock", "list of texts"]),
        ("system80", "system8", ["generator.name", "did you mean system80?"]),
        ("system80", "none.toml", ["generator.name", "no such file"]),
        ("[source]", '[camera]\nfile = "none.toml"\n[source]', ["camera.file", "no such file"]),
        ("[source]", "[measure]\n[source]", ["measure", "did you mean measuring?"]),
        ("[source]", '[measuring]\nfield_order = "botom"\n[source]', ["field_order = 'botom'", "did you mean bottom?"]),
        ("[source]", "[measuring]\noldest_frame_ms = 0\n[source]", ["oldest_frame_ms = 0", "at least 20"]),
        ("[source]", '[console]\naddress = "station"\n[source]', ["console.address = 'station'", "127.0.0.1"]),
        ("[source]", '[console]\nnames = ["http://x"]\n[source]', ["console.names", "'http://x' is no host name"]),
        ("[source]", "[console]\nrate_hz = 60\n[source]", ["console.rate_hz = 60", "at most 30"]),
        ("[source]", "[console]\nclients = 0\n[source]", ["console.clients = 0", "at least 1"]),
        ("[source]", "[console]\nadress = 1\n[source]", ["console.adress", "did you mean address?"]),
        ("[source]", '[viewer]\naddress = "0.0.0.0"\n[source]', ["viewer.address = '0.0.0.0'", "loopback"]),
        ("[source]", '[viewer]\naddress = "localhost"\n[source]', ["viewer.address", "127.0.0.1"]),
        ("[source]", "[viewer]\nport = 70000\n[source]", ["viewer.port = 70000", "at most 65535"]),
        ("[source]", "[viewer]\nport = true\n[source]", ["viewer.port = True", "whole number"]),
        ("[source]", "[viewer]\nmemory_mb = 1\n[source]", ["viewer.memory_mb", "did you mean memory_mib?"]),
        ("[source]", '[viewer]\nenabled = "yes"\n[source]', ["viewer.enabled", "true or false"]),
    ],
)
def test_what_is_unknown_or_impossible_is_refused_by_name(tmp_path, old, new, words):
    with pytest.raises(ConfigError) as error:
        station(tmp_path, MINIMAL.replace(old, new))
    for word in [str(tmp_path / "station.toml"), *words]:
        assert word in str(error.value)
    assert "\n" not in str(error.value)
