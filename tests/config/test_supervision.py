from pathlib import Path

import pytest

from drivers.errors import ConfigError
from service.config.shipped import shipped_config
from service.config.station import read_station
from service.config.supervision import SupervisionSettings

MINIMAL = '[source]\ndevice = "simulated"\n[generator]\nname = "system80"\n'


def supervision(folder: Path, text: str):
    path = folder / "station.toml"
    path.write_text(f"{MINIMAL}[supervision]\n{text}\n")
    return read_station(path).supervision


def test_the_shipped_file_says_what_the_defaults_are():
    assert read_station(shipped_config("station.toml")).supervision == SupervisionSettings()


def test_keys_are_taken_and_the_rest_left(tmp_path):
    taken = supervision(tmp_path, "stall_s = 2\nusb_reset = true")
    assert taken == SupervisionSettings(stall_s=2.0, usb_reset=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stall_s = 0", "stall_s"),
        ("frozen_frames = 1", "frozen_frames"),
        ("usb_reset = 1", "usb_reset"),
        ("stal_s = 1", "did you mean"),
        ("retry_first_s = 3\nretry_most_s = 2", "retry_most_s: must be at least retry_first_s = 3|retry_most_s"),
    ],
)
def test_what_cannot_be_is_refused_by_name(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words):
        supervision(tmp_path, text)
