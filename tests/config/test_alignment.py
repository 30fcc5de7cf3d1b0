import re

import numpy as np
import pytest

from drivers.errors import ConfigError
from service.alignment.bands import Bands
from service.alignment.setup import GuideSetup
from service.config.alignment import IdentitySettings
from service.config.generators import load_generator
from service.config.guide import read_guide, write_guide
from service.config.shipped import shipped_config
from service.config.station import read_station
from service.identity.counting import Growth
from service.identity.names import Leg
from tests.alignment.scenes import geometry_of, guide_over, random_pose

STATION = '[source]\ndevice = "bowl.mp4"\n[generator]\nname = "system80"\n'
GUIDE = "mouth_mm = [40, 0, 900]\naxis = [0, 0, 2]\naxis_sigma_deg = 0.1\npoint_sigma_mm = 0.2\n"
SET_UP = '[alignment]\nguide = "guide.toml"\nprobe_diameter_mm = 15.5\n'


@pytest.fixture
def station(tmp_path):
    def read(text, guide=GUIDE):
        (tmp_path / "station.toml").write_text(STATION + text)
        (tmp_path / "guide.toml").write_text(guide)
        return read_station(tmp_path / "station.toml")

    return read


def test_without_a_guide_there_is_no_alignment(station):
    for s in (
        station(""),
        station("[alignment]\nprobe_diameter_mm = 15\n"),
        read_station(shipped_config("station.toml")),
    ):
        assert s.alignment is None
        assert s.identity == IdentitySettings()


def test_the_shipped_file_says_what_the_defaults_are(station):
    text = shipped_config("station.toml").read_text()
    alignment = re.search(r"^\[alignment\]\n.*?(?=^\[viewer\])", text, re.MULTILINE | re.DOTALL)[0]
    said = station(alignment.replace('# guide = "guide.toml"', 'guide = "guide.toml"\nprobe_diameter_mm = 15.5'))
    bare = station(SET_UP)
    for key in ("gap_sigma_mm", "target", "stale_after_s", "average_s", "bands", "tube_diameter_mm", "gap_mm"):
        assert getattr(said.alignment, key) == getattr(bare.alignment, key), key
    assert bare.alignment.bands == Bands()


def test_a_guide_makes_a_geometry_with_the_generators_tube(station):
    s = station(SET_UP)
    geometry = s.alignment.settings(s.generator).geometry
    assert geometry.tube_diameter_mm == pytest.approx(16.9164)
    assert geometry.clearance_mm == pytest.approx(0.7082)
    assert geometry.guide.direction.tolist() == [0, 0, 1]
    assert geometry.arm_normal.tolist() == [0, 0, 1]
    assert geometry.guide.at_mouth
    assert np.sqrt(np.diag(geometry.guide.covariance)) == pytest.approx([np.radians(0.1)] * 3 + [0.2] * 3)
    with pytest.raises(ConfigError, match="does not go into a tube of CANDU 6"):
        s.alignment.settings(load_generator("candu6"))


def test_an_identity_is_read(station):
    s = station(
        '[identity]\nsteam_generator = "SG2"\nleg = "CL"\nrows_grow = "up"\ncolumns_grow = "left"\nmap = "system80"\n'
    )
    rule = s.identity.rule(s.generator)
    assert (rule.leg, rule.rows_grow, rule.columns_grow) == (Leg.COLD, Growth.UP, Growth.LEFT)
    assert rule.full(rule.parse("83/87")) == "SG2 CL L83R87"
    assert rule.mirrored is False
    assert rule.map.holds(rule.parse("L83R87"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[alignment]\nguide = 'none.toml'\n", ["alignment.guide = 'none.toml'", "no such file"]),
        ("[alignment]\nguide = 'guide.toml'\n", ["alignment.probe_diameter_mm", "missing"]),
        (SET_UP.replace("15.5", "17"), ["probe_diameter_mm = 17", "does not go into", "16.92"]),
        (SET_UP + "tube_diameter_mm = 15\n", ["probe_diameter_mm", "inner diameter 15.00"]),
        (SET_UP + "arm_normal = [0, 0, 0]\n", ["arm_normal", "direction"]),
        (SET_UP + 'target = "L83R88"\n', ["alignment.target = 'L83R88'", "must be even"]),
        (SET_UP + 'target = "the next"\n', ["target", "cannot be read"]),
        (SET_UP + "probe_diametre_mm = 3\n", ["did you mean probe_diameter_mm"]),
        (SET_UP + "gap_mm = -1\n", ["gap_mm = -1", "at least 0"]),
        ("[alignment.bands]\noffset_normal_mm = 0.6\n", ["alignment.bands.offset_advisory_mm", "at least", "0.6"]),
        ("[alignment.bands]\ntilt_hysteresis_deg = 0.5\n", ["tilt_hysteresis_deg = 0.5", "below"]),
        ("[alignment.bands]\noffset_sigma_mm = 0.3\n", ["offset_sigma_mm = 0.3", "could not tell"]),
        ("[alignment.bands]\noffset_norml_mm = 0.3\n", ["did you mean offset_normal_mm"]),
        ('[identity]\nrows_grow = "up"\n', ["rows_grow", "both"]),
        ('[identity]\nrows_grow = "up"\ncolumns_grow = "down"\n', ["columns_grow = 'down'", "right angle"]),
        ('[identity]\nrows_grow = "north"\ncolumns_grow = "down"\n', ["rows_grow = 'north'", "one of right, down"]),
        ('[identity]\nleg = "hot"\n', ["leg = 'hot'", "HL, CL"]),
        ('[identity]\nmap = "model-f"\n', ["map model-f is square", "system80 is triangular"]),
        ('[identity]\nmap = "x"\n', ["identity.map = 'x'", "unknown"]),
        ('[identity]\ncounts_along = "lines"\n', ["counts_along", "rows, columns"]),
        ('[identity]\nsteam_generator = "12"\n', ["steam_generator = '12'", "letter"]),
    ],
)
def test_what_is_impossible_is_refused_by_key(station, text, words):
    with pytest.raises(ConfigError) as error:
        station(text)
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("guide", "words"),
    [
        (GUIDE.replace("mouth_mm = [40, 0, 900]", ""), ["guide.toml", "either mouth_mm"]),
        (GUIDE + "point_mm = [1, 2, 3]\n", ["either mouth_mm"]),
        (GUIDE.replace("mouth_mm", "point_mm"), ["gap_mm", "missing", "does not tell where its mouth is"]),
        (GUIDE.replace("[0, 0, 2]", "[0, 0, 0]"), ["axis", "direction"]),
        (GUIDE.replace("axis_sigma_deg = 0.1", ""), ["axis_sigma_deg", "missing"]),
        (GUIDE + "covariance = [[1]]\n", ["axis_sigma_deg", "not both"]),
        (GUIDE.partition("axis_sigma")[0] + f"covariance = {(-np.eye(6)).tolist()}\n", ["covariance", "positive"]),
        (GUIDE + "roll_deg = 3\n", ["roll_deg", "unknown key"]),
    ],
)
def test_an_impossible_guide_is_refused_by_key(station, guide, words):
    with pytest.raises(ConfigError) as error:
        station(SET_UP, guide)
    for word in words:
        assert word in str(error.value)


def test_a_point_that_is_no_mouth_needs_a_gap(station):
    s = station(SET_UP + "gap_mm = 25\n", GUIDE.replace("mouth_mm", "point_mm"))
    assert (s.alignment.gap_mm, s.alignment.guide.at_mouth) == (25, False)


@pytest.mark.parametrize("at_mouth", [True, False])
def test_a_written_guide_is_read_back(tmp_path, at_mouth):
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * 0.01
    covariance = root @ root.T
    guide = guide_over(*random_pose(rng), (3, 4), (0.01, 0.02), covariance=covariance)
    guide = type(guide)(guide.point_mm, guide.direction, covariance, at_mouth)
    path = tmp_path / "guide.toml"
    write_guide(path, GuideSetup(guide, 0.1, 0.1, 0.2, 0.2, 4, 60.0, [0.1]), "2026-01-01T00:00:00Z", "bowl.mp4", "lens")
    read = read_guide(path)
    assert read.point_mm == pytest.approx(guide.point_mm, abs=1e-12)
    assert read.direction == pytest.approx(guide.direction, abs=1e-15)
    assert read.covariance == pytest.approx(guide.covariance, rel=1e-12)
    assert read.at_mouth is at_mouth
    assert ("gap_mm" in path.read_text()) is not at_mouth
    assert geometry_of(read).clearance_mm > 0
