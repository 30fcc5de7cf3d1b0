import re

import numpy as np
import pytest

from drivers.errors import ConfigError
from service.config.points import read_points

SOUND = "0 0 0 10 20\n25.4 0 0 30.5 20\n0 25.4 0 10 41\n25.4 25.4 0 31 41.5\n50.8 0 0 51 19\n"


@pytest.fixture
def points(tmp_path):
    path = tmp_path / "points.dat"

    def read(text):
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_points(path)

    return read


def test_a_line_is_a_point(points):
    sheet, picture = points(SOUND)
    assert sheet.shape == (5, 3)
    np.testing.assert_array_equal(sheet[1], (25.4, 0, 0))
    np.testing.assert_array_equal(picture[3], (31, 41.5))


def test_willsons_own_number_format_is_read(points):
    line = "-2.5400000000e+01 -4.3994090512e+01 0.0000000000e+00 1.3875245505e+02 3.7471100830e+01\n"
    sheet, picture = points(line + SOUND)
    assert sheet[0, 0] == -25.4
    assert picture[0, 1] == 37.471100830


@pytest.mark.parametrize(
    "text",
    [
        "# from the bench\n\n" + SOUND,
        SOUND.replace("\n", "   # seen well\n"),
        SOUND.replace(" ", "\t").replace("\n", "\r\n"),
        "\ufeff" + SOUND.rstrip(),
        SOUND.replace("25.4 0 0 30.5", "25.4 0 -0.0 30.5"),
    ],
    ids=["comment", "comment after", "tabs and CRLF", "byte order mark", "minus zero"],
)
def test_comments_blanks_and_line_ends_do_not_matter(points, text):
    np.testing.assert_array_equal(np.hstack(points(text)), np.hstack(points(SOUND)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("25.4 0 0 30.5 20", "25.4 0 0 30.5", "points.dat:2: '25.4 0 0 30.5': 4 values; a line holds five numbers"),
        ("25.4 0 0 30.5 20", "25.4 0 0 30.5 20 7", "points.dat:2: '25.4 0 0 30.5 20 7': 6 values"),
        ("25.4 0 0 30.5 20", "25,4 0 0 30,5 20", "'25,4' is no number; a line holds five numbers, xw yw zw"),
        ("0 25.4 0 10 41", "0 25.4 0 nan 41", "points.dat:3: '0 25.4 0 nan 41': not finite"),
        ("0 25.4 0 10 41", "0 25.4 0 1e999 41", "not finite; leave out"),
        ("0 25.4 0 10 41", "0 25.4 2.5 10 41", "points.dat:3: zw = 2.5, but the first has 0; give points of one plane"),
        ("50.8 0 0 51 19\n", "", "points.dat: 4 points; give at least 5"),
        (SOUND, "", "points.dat: 0 points"),
        ("25.4 0 0 30.5 20", "x" * 500, r"'x+\.\.\.'"),
    ],
)
def test_what_is_no_point_is_named(points, old, new, message):
    with pytest.raises(ConfigError, match=message if message.startswith("'x") else re.escape(message)) as caught:
        points(SOUND.replace(old, new, 1))
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 400


def test_a_picture_is_no_point_file(points):
    with pytest.raises(ConfigError, match=r"points\.dat: not text \(byte 0\); is it a point file"):
        points(b"\x89PNG\r\n\x1a\n" + bytes(100))


def test_what_cannot_be_opened_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.dat: no such file"):
        read_points(tmp_path / "none.dat")
    with pytest.raises(ConfigError, match="is a folder; name a point file"):
        read_points(tmp_path)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_points(tmp_path / ("n" * 300))


def test_a_file_too_large_is_not_read(tmp_path):
    path = tmp_path / "video.dat"
    with path.open("wb") as file:
        file.truncate(60_000_000)
    with pytest.raises(ConfigError, match="larger than 50 MB"):
        read_points(path)
