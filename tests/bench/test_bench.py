import re

import cv2
import numpy as np
import pytest

from tests.bench.__main__ import SECTIONS, main
from tests.bench.pictures import Truth
from tests.bench.side_by_side import score
from tests.bench.tables import table
from tests.bench.timing import interleaved


@pytest.fixture
def threads_as_before():
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


@pytest.mark.slow
@pytest.mark.parametrize("section", SECTIONS)
def test_every_section_gives_a_table_without_gaps(section, threads_as_before, capsys):
    main(["--quick", "--only", section])
    printed = capsys.readouterr().out
    assert f"### {SECTIONS[section][0]}" in printed
    rows = [line for line in printed.splitlines() if line.startswith("|")]
    assert len(rows) >= 3
    assert len({row.count("|") for row in rows}) == 1
    if section == "peers":
        own = [row.split("|")[1:-1] for row in rows if "Bowlsight" in row]
        assert len(own) >= 4
        assert all(float(row[5]) > 90 and float(row[7]) < 0.3 for row in own)  # found %, error px


def test_finds_are_scored_against_what_must_and_what_may_be_found():
    truth = Truth(
        np.array([[10.0, 10.0], [50.0, 10.0], [90.0, 10.0]]), np.array([True, True, False]), np.eye(3), np.zeros(3)
    )
    found = np.array([[10.3, 10.4], [11.0, 10.0], [90.0, 10.0], [70.0, 10.0]])  # one twice, a plug, one of nothing
    s = score(found, truth, 40.0)
    assert (s.found, s.false) == (0.5, 1)
    np.testing.assert_allclose(s.squares, [0.125, 0.5])
    nothing = score(np.zeros((0, 2)), truth, 40.0)
    assert (nothing.found, nothing.false, nothing.squares.size) == (0.0, 0, 0)


def test_calls_take_turns_and_one_that_is_slow_gives_up_its_later_ones():
    calls = []

    def call(name):
        return lambda number: calls.append((name, number))

    times = interleaved({"a": call("a"), "b": call("b")}, range(100), rounds=3, budget_s=60.0, skip=1)
    assert calls == [(name, k) for k in range(4) for name in "ab"]
    assert [k for k, _ in times["a"].results] == [1, 2, 3]
    calls.clear()
    interleaved({"a": call("a")}, range(100), rounds=50, budget_s=0.0, skip=1)
    assert len(calls) == 3


def test_a_table_shows_three_figures_and_a_dash_for_nothing():
    text = table(("what", "a", "b"), [["x", 1234.5, None], ["longer", 0.012345, float("nan")]])
    assert [re.sub(r"\s+", " ", line) for line in text.splitlines()] == [
        "| what | a | b |", "|--------|-------:|--:|", "| x | 1234 | - |", "| longer | 0.0123 | - |",
    ]  # fmt: skip
