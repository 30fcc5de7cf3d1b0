"""What was seen is laid on the plant's map by names, and only where these agree."""

import numpy as np
import pytest

from service.config.generators import load_generator
from service.identity.counting import NamingRule
from service.identity.maps import load_map
from service.report.map_plot import map_from_sheet, overview
from service.report.sheet import Sheet, Tube

KNOWN = load_map("model-f")
GENERATOR = load_generator("model-f")
RULE = NamingRule(GENERATOR.naming, GENERATOR.lattice, map=KNOWN)


@pytest.fixture
def sheet():
    """Rows that count against the lattice's, from another beginning."""
    tubes = {(r, c): Tube(f"ROW{30 - r} COL{40 + c}") for r in range(-3, 4) for c in range(5)}
    return Sheet(1, tubes, camera_mm={0: (0.0, 0.0)}, probe_mm={0: (1.0, 1.0)})


def test_places_come_to_lie_where_their_names_are(sheet):
    matrix = map_from_sheet(sheet, RULE, KNOWN)
    at = np.array([*RULE.lattice.sheet_points(np.array([20]), np.array([-10]))[0], 1.0]) @ matrix
    assert at == pytest.approx(KNOWN.places_mm(10, 30), abs=1e-6)
    assert 'id="map1-' in overview(sheet, RULE)


def test_names_of_several_counts_tell_nothing(sheet):
    sheet.tubes[0, 0].name = "ROW31 COL40"
    assert map_from_sheet(sheet, RULE, KNOWN) is None
    assert overview(sheet, RULE) is None


@pytest.mark.parametrize("keep", [0, 3, 5])
def test_too_few_names_or_all_in_one_line_tell_nothing(sheet, keep):
    for k, tube in enumerate(sheet.tubes.values()):
        tube.name = tube.name if k < keep else None
    assert map_from_sheet(sheet, RULE, KNOWN) is None


def test_a_name_that_cannot_be_is_left_out(sheet):
    sheet.tubes[0, 0].name = "$not a name$"
    assert map_from_sheet(sheet, RULE, KNOWN) is not None


def test_without_a_map_there_is_no_overview(sheet):
    assert overview(sheet, NamingRule(GENERATOR.naming, GENERATOR.lattice)) is None
