"""A session of real measurements with a guide: the report's figures are those of the recorded lines."""

import math
import re
from collections import Counter

import pytest

from service.demo import demo_video
from service.sinks.session.reader import open_session
from tests.cli.test_session_replay import record
from tests.report.test_page import report

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return open_session(record(demo_video(), tmp_path_factory.mktemp("real"), "model-f", 24))


def test_verdicts_tubes_and_offsets_are_those_recorded(session):
    page, said = report(session.folder)
    lines = list(session.results())
    verdicts = Counter(line["alignment"]["verdict"] for line in lines)
    for verdict, count in verdicts.items():
        assert f"{verdict} {count:,} ({count / len(lines):.1%})" in said.replace("\N{NO-BREAK SPACE}", " ")
    visited = {}
    for line in lines:
        a = line["alignment"]
        if a["place"] is not None and "index" not in line["doubt"] and a["offset_mm"] is not None:
            visited.setdefault(a["target"], []).append(math.hypot(*a["offset_mm"]))
    assert visited
    smallest = min(min(offsets) for offsets in visited.values())
    assert f"{smallest:.2f} ± " in said.replace("\N{NO-BREAK SPACE}", " ")
    assert "reopened" in said
    assert 'id="plan1-' in page
    assert 'id="plan2-' in page
    assert len(re.findall(r"<svg", page)) >= 3
