"""An index that the map has mended: the sheet has not moved for that."""

import numpy as np
import pytest

from drivers.scene import CLEAN
from service.vision.evidence import Verdict
from service.vision.motion import Motion
from service.vision.stopwatch import Stopwatch
from service.vision.tracking import Tracker
from tests.scenes.rendered import PERIOD_NS, looking, sheet_of, view


def test_a_relabelled_motion_predicts_the_same_view():
    rotation, translation = looking(7.0, at_mm=(30.0, -12.0))
    motion = Motion(rotation, translation, np.array([28.0, -9.0]), 0, np.array([0.1, 0.0, 0.2]), np.array([5.0, 1, 2]))
    step = np.array([25.4, 50.8])
    (R0, t0), (R1, t1) = motion.at(10**9), motion.relabelled(step).at(10**9)
    point = np.array([100.0, 40.0])
    assert pytest.approx(R0) == R1
    assert R1[:, :2] @ (point + step) + t1 == pytest.approx(R0[:, :2] @ point + t0)


def test_after_the_map_has_mended_an_index_it_stays_mended(monkeypatch):
    first = view("system80", CLEAN)
    tracker = Tracker(first.camera, first.lattice)
    sheet = sheet_of(first.sheet.lattice, CLEAN)
    verdicts = iter([None, Verdict(1, -1, 50.0, 50.0)])
    monkeypatch.setattr(tracker._map, "fit", lambda _: -1.0)
    monkeypatch.setattr(tracker._map, "compare", lambda *_: next(verdicts, None))
    places = []
    for i in range(6):
        v = view("system80", CLEAN, pose=looking(4.0, at_mm=(0.5 * i, 0.0)), sheet=sheet)
        refined = tracker.step(v.image, None, i * PERIOD_NS, Stopwatch(lambda: 0)).refined
        nearest = np.argmin(np.hypot(*(refined.predicted_px - np.array(v.optics.principal_point_px)).T))
        places.append((int(refined.sites.row[nearest]), int(refined.sites.column[nearest])))
    row, column = places[0]
    mended = places.index((row + 1, column - 1))
    assert 0 < mended < 3
    assert places[mended:] == [(row + 1, column - 1)] * (6 - mended)
    assert np.hypot(*tracker.motion.speed_mm_per_s[:2]) < 25.0
