"""Where camera and probe were, which tubes were seen and visited."""

import numpy as np
import pytest

from service.report.sheet import Sheet, look


def rotation(about_x_deg):
    c, s = np.cos(np.radians(about_x_deg)), np.sin(np.radians(about_x_deg))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def pose(center, about_x_deg=0.0):
    turned = rotation(about_x_deg)
    return {"rotation": turned.tolist(), "translation_mm": (-turned @ np.array(center)).tolist()}


def tube(row, column, origin="measured", state="open", name=None):
    return {"row": row, "column": column, "origin": origin, "state": state, "name": name}


def line(tubes=(), doubt=(), place=None, offset=None, verdict="adjust"):
    alignment = None
    if place is not None:
        alignment = {
            "target": "nearest", "place": list(place), "verdict": verdict, "offset_mm": offset,
            "sigma_mm": None if offset is None else [0.1, 0.2],
            "entry": None if offset is None else {"center_mm": [1.0, 2.0]},
        }  # fmt: skip
    return {"pose": pose((30.0, 40.0, -1000.0)), "doubt": list(doubt), "tubes": list(tubes), "alignment": alignment}


def test_a_camera_that_looks_straight_is_over_what_it_sees():
    foot, seen = look(pose((30.0, 40.0, -1000.0)))
    assert foot == pytest.approx((30, 40))
    assert seen == pytest.approx((30, 40))


def test_a_camera_that_is_tilted_looks_beside_its_foot():
    foot, seen = look(pose((30.0, 40.0, -1000.0), 10.0))
    assert foot == pytest.approx((30, 40))
    assert seen == pytest.approx((30, 40 + 1000 * np.tan(np.radians(10))))


def test_a_camera_that_looks_along_the_sheet_sees_no_place():
    assert look(pose((0.0, 0.0, -1000.0), 89.0))[1] is None


def test_the_state_that_most_pictures_show_is_a_tubes_own():
    sheet = Sheet(1)
    plugged, open_ = tube(0, 0, "inferred", "plugged"), tube(0, 0)
    for step, seen in enumerate((plugged, plugged, open_, tube(0, 0, "inferred", "unknown"))):
        sheet.add(step, step, line([seen, tube(5, 5, "inferred", "unknown")]))
    assert sheet.tubes[0, 0].state == "plugged"
    assert sheet.tubes[5, 5].state == "predicted"


def test_a_visit_has_its_smallest_offset_with_the_sigma_of_that():
    sheet = Sheet(1)
    for k, offset in enumerate(([3.0, 4.0], [0.3, 0.4], None)):
        sheet.add(k, 100 + k, line([tube(1, 2, name="L83R87")], place=(1, 2), offset=offset))
    visit = sheet.visits[1, 2]
    assert (visit.tube, visit.first_ns, visit.last_ns) == ("L83R87", 100, 102)
    assert (visit.best_mm, visit.best_sigma_mm) == (pytest.approx(0.5), 0.2)
    assert visit.verdicts == {"adjust": 3}
    assert sheet.probe_mm == {0: (1.0, 2.0), 1: (1.0, 2.0)}


def test_a_tube_without_a_name_is_told_by_its_place():
    sheet = Sheet(1)
    sheet.add(0, 0, line([tube(-1, 2)], place=(-1, 2)))
    assert sheet.visits[-1, 2].tube == "place -1, 2"


def test_pictures_whose_index_is_in_doubt_name_nothing():
    sheet = Sheet(1)
    sheet.add(0, 0, line([tube(0, 0)], doubt=["index"], place=(0, 0)))
    assert (sheet.pictures, sheet.tubes, sheet.visits) == (1, {}, {})
