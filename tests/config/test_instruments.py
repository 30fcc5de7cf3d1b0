import re

import pytest

from drivers.errors import ConfigError
from drivers.serial_port import LineSettings
from drivers.zoom_table import SONY_25X
from service.config.instruments import RangeFinderModel, RangeFinderSettings
from service.config.shipped import shipped_config
from service.config.station import read_station

STATION = '[source]\ndevice = "bowl.mp4"\n[generator]\nname = "system80"\n'
PORT = 'port = "/dev/serial/by-id/usb-x"\n'


@pytest.fixture
def station(tmp_path):
    def read(text):
        path = tmp_path / "station.toml"
        path.write_text(STATION + text)
        return read_station(path)

    return read


def test_a_station_without_the_tables_has_no_instruments(station):
    for s in (station(""), station("[lens]\n[range_finder]\n"), read_station(shipped_config("station.toml"))):
        assert (s.lens, s.range_finder) == (None, None)


def test_the_shipped_file_says_what_the_defaults_are(station):
    shipped = re.sub(r"^# (\w+ = )", r"\1", shipped_config("station.toml").read_text(), flags=re.MULTILINE)
    tables = re.findall(r"^\[(?:lens|range_finder)\]$.*?(?=^\[)", shipped, flags=re.MULTILINE | re.DOTALL)
    said = station("".join(tables))
    bare = station(f'[lens]\nport = "{said.lens.port}"\n[range_finder]\nport = "/dev/x"\nmodel = "dimetix"\n')
    for key in ("line", "address", "rate_hz", "stale_after_s", "autofocus_off", "digital_zoom_off", "tolerance_counts"):
        assert getattr(said.lens, key) == getattr(bare.lens, key), key
    for key in ("line", "device_id", "rate_hz", "stale_after_s", "offset_mm"):
        assert getattr(said.range_finder, key) == getattr(bare.range_finder, key), key
    assert said.lens.zoom_table.ratio(8192)[0] == pytest.approx(3)
    assert bare.lens.zoom_table is SONY_25X


@pytest.mark.parametrize(
    ("model", "line"), [("dimetix", LineSettings(19200, 7, "E", 1)), ("acuity", LineSettings(9600, 8, "N", 1))]
)
def test_a_line_is_as_the_model_leaves_the_factory(station, model, line):
    s = station(f'[range_finder]\n{PORT}model = "{model}"\n')
    assert s.range_finder == RangeFinderSettings("/dev/serial/by-id/usb-x", RangeFinderModel(model), line)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[lens]\nrate_hz = 5\n", ["lens.port", "missing"]),
        ('[lens]\nport = "COM1"\n', ["lens.port = 'COM1'", "/dev/serial/by-id"]),
        ('[lens]\nport = "socket://h"\n', ["lens.port", "socket://HOST:PORT"]),
        (f"[lens]\n{PORT}address = 8\n", ["lens.address = 8", "at most 7"]),
        (f"[lens]\n{PORT}adress = 1\n", ["lens.adress", "did you mean address?"]),
        (f'[lens]\n{PORT}framing = "8N"\n', ["lens.framing = '8N'", "such as 8N1"]),
        (f"[lens]\n{PORT}rate_hz = 0\n", ["lens.rate_hz = 0", "at least 0.1"]),
        (f"[lens]\n{PORT}rate_hz = 0.5\n", ["lens.stale_after_s", "more than 2"]),
        (f"[lens]\n{PORT}wide_focal_length_mm = 0\n", ["wide_focal_length_mm = 0", "above 0"]),
        (f"[lens]\n{PORT}zoom_table = [0, 1]\n", ["zoom_table", "list of pairs"]),
        (f"[lens]\n{PORT}zoom_table = [[0, 1], [9, true]]\n", ["zoom_table", "must be a number"]),
        (f"[lens]\n{PORT}zoom_table = [[0, 1]]\n", ["zoom_table", "at least two points"]),
        (f"[lens]\n{PORT}zoom_table = [[0, 2], [9, 1]]\n", ["zoom_table", "growing"]),
        (f"[lens]\n{PORT}calibrated_focus_position = 9\n", ["calibrated_focus_position", "calibrated_zoom_position"]),
        (f"[range_finder]\n{PORT}", ["range_finder.model", "missing", "dimetix, acuity"]),
        (f'[range_finder]\n{PORT}model = "dimetics"\n', ["range_finder.model", "did you mean dimetix?"]),
        (f'[range_finder]\n{PORT}model = "acuity"\nsigma_mm = 0\n', ["sigma_mm = 0", "above 0"]),
        (f'[range_finder]\n{PORT}model = "acuity"\nstale_after_s = 0.4\n', ["stale_after_s = 0.4", "more than 0.5"]),
        (f'[range_finder]\n{PORT}model = "acuity"\noffset_mm = nan\n', ["offset_mm", "finite"]),
    ],
)
def test_what_is_unknown_or_impossible_is_refused_by_name(station, tmp_path, text, words):
    with pytest.raises(ConfigError) as error:
        station(text)
    for word in [str(tmp_path / "station.toml"), *words]:
        assert word in str(error.value)
    assert "\n" not in str(error.value)
