import pytest

from drivers.errors import ConfigError
from service.config.generators import Naming
from service.identity.maps import MAPS, load_map
from service.identity.names import TubeName

SOUND = """approximate = true
arrangement = "square"
pitch_mm = 25
rows = 4
columns = 5
first_row_mm = 12.5
outer_radius_mm = 1000
"""


@pytest.mark.parametrize(("name", "tubes"), [("model-f", 5626), ("51b", 3330), ("system80", 8206)])
def test_the_shipped_maps_count_what_the_plants_do(name, tubes):
    found = load_map(name)
    assert found.count() == tubes
    assert found.approximate


def test_a_system_80_has_no_tube_under_the_stay_cylinder_beyond_the_shroud_or_of_odd_sum():
    found = load_map("system80")
    held = {text: found.holds(TubeName(Naming.LINE_ROW, *text)) for text in [(87, 83), (88, 83), (1, 83), (137, 165)]}
    assert held == {(87, 83): True, (88, 83): False, (1, 83): False, (137, 165): False}
    assert not found.holds(TubeName(Naming.LINE_ROW, 139, 83))


def test_every_shipped_map_is_listed():
    assert all(load_map(name).name == name for name in MAPS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("rows = 4|rows = 0", ["rows = 0", "at least 1"]),
        ("square|rotated-square", ["arrangement", "must be square or triangular"]),
        ("approximate = true|", ["approximate", "missing"]),
        ("pitch_mm = 25|pitch_mm = 25\nradius = 3", ["radius", "unknown key"]),
        ("outer_radius_mm = 1000|outer_radius_mm = 10\ninner_radius_mm = 20", ["inner_radius_mm", "at most 10"]),
    ],
)
def test_an_impossible_map_is_refused_by_key(tmp_path, change, words):
    path = tmp_path / "map.toml"
    path.write_text(SOUND)
    assert load_map(str(path)).count() == 20
    path.write_text(SOUND.replace(*change.split("|")))
    with pytest.raises(ConfigError) as error:
        load_map(str(path))
    for word in words:
        assert word in str(error.value)


def test_an_unknown_map_names_the_nearest():
    with pytest.raises(ConfigError, match="did you mean system80"):
        load_map("system-80")
