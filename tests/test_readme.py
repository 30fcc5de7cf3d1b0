"""What the front page tells users can be typed as it stands."""

import re
import shlex
from pathlib import Path

import pytest

from service import __version__
from service.cli.parser import COMMANDS, parse

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
LINES = [
    re.split(r" {2,}", line.strip())[0]
    for line in re.sub(r"\\\n\s+", "", README).splitlines()
    if line.startswith("    bowlsight ")
]


@pytest.mark.parametrize("line", LINES)
def test_every_command_line_can_be_parsed(line):
    words = shlex.split(line)
    assert parse(words[1:]).command == words[1]


def test_every_command_is_shown():
    assert {line.split()[1] for line in LINES} == set(COMMANDS)


def test_every_make_target_exists():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    named = re.findall(r"`make ([a-z-]+)`|^    make ([a-z-]+)", README, re.MULTILINE)
    assert {a or b for a, b in named} <= set(targets)
    assert named[0][1] == "run"


def test_every_file_it_points_to_is_there():
    linked = re.findall(r"\]\(([^):]+)\)", README)
    assert "docs/viewer.png" in linked
    assert [path for path in linked if not (ROOT / path).is_file()] == []


def test_the_changelog_knows_this_version():
    assert f"## [{__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
