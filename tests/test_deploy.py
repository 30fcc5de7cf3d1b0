"""What is shipped for a station's machine says what the program does."""

import configparser
import re
from pathlib import Path

from drivers import access
from service.cli.parser import parse
from service.config.shipped import shipped_config
from service.precedence import FIRST

UNIT = shipped_config("deploy/bowlsight.service")
RULES = shipped_config("deploy/70-bowlsight.rules")


class Unit(configparser.ConfigParser):
    def optionxform(self, option):
        return option


def unit() -> Unit:
    read = Unit(strict=False, interpolation=None)
    read.read_string(UNIT.read_text())
    return read


def test_the_unit_starts_a_command_that_there_is_and_is_watched():
    service = unit()["Service"]
    _, *words = service["ExecStart"].split()
    assert parse(words).command == "run"
    assert service["Type"] == "notify"
    assert int(service["WatchdogSec"]) >= 10
    assert (service["Restart"], service["RestartPreventExitStatus"]) == ("on-failure", "2")


def test_the_unit_lets_capture_and_measuring_go_first():
    assert int(unit()["Service"]["LimitNICE"]) == FIRST


def test_the_unit_allows_the_devices_that_the_drivers_open():
    allowed = set(re.findall(r"^DeviceAllow=char-(\w+) rw$", UNIT.read_text(), re.MULTILINE))
    assert allowed == {"video4linux", "usb_device", "ttyS", "ttyUSB", "ttyACM"}
    assert unit()["Service"]["SupplementaryGroups"].split() == ["video", "dialout"]


def test_the_rule_that_errors_name_is_the_one_shipped():
    assert Path(access.RULE).name == RULES.name
    rules = [line for line in RULES.read_text().splitlines() if line and not line.startswith("#")]
    assert all(re.fullmatch(r'([A-Z]+(\{[\w/]+\})?(==|\+=|=)"[^"]*"(, )?)+', rule) for rule in rules)
    assert 'SUBSYSTEM=="video4linux", KERNEL=="video[0-9]*", GROUP="video", MODE="0660"' in rules


def test_the_description_names_files_that_there_are():
    root = RULES.parents[2]
    text = (root / "docs/deploy.md").read_text() if (root / "docs").is_dir() else ""
    for path in re.findall(r"config/deploy/[\w.-]+\w", text):
        assert (root / path).exists(), path
