import math
from dataclasses import replace

import numpy as np
import pytest

from service.alignment.desk import AlarmDesk
from service.alignment.interpreter import Interpreter
from service.config.console import ConsoleSettings
from service.console.access import Access, Bucket, Buckets, Right, Tokens
from service.console.board import Board
from service.console.console import Console
from service.console.message import frame_head, frame_message, marks
from service.console.server import bind
from service.console.trend import FIELDS, Trend
from service.console.watched import About, RefusedError
from service.identity.namer import TubeNamer
from service.vision.measurement import Doubt, Lock
from tests.browser.served import aligner_at
from tests.fakes.clock import ManualClock
from tests.fakes.drawn import LATTICE, made_up
from tests.fakes.station import RULE, FakeStation

SECOND = 1_000_000_000


def told(station, frame, result):
    """The head of the message that the station's pages get of a frame."""
    station.show(frame, result)
    return frame_head(station.latest, RULE, station.operations.place_in(station.latest))


# -- messages ----------------------------------------------------------------------------------------------------------


def test_a_frame_without_a_lock_is_a_picture_with_the_reason():
    frame, result = made_up(3, lock=Lock.NONE, reason="too dark")
    head = frame_head(result, RULE, None)
    assert (head["lock"], head["why"], head["pose"], head["names"]) == ("none", "too dark", None, None)
    assert len(marks(result.measurement, LATTICE)) == 0
    assert frame_message(head, marks(result.measurement, LATTICE), frame.pixels, 85)[-2:] == b"\xff\xd9"


def test_a_doubt_is_told():
    assert frame_head(made_up(lock=Lock.PARTIAL, doubt=(Doubt.LIGHT,))[1], RULE, None)["why"] == "light in doubt"


def test_marks_that_cannot_be_drawn_are_left_out():
    m = made_up()[1].measurement
    centers = m.tubes.center_px.copy()
    centers[0], centers[1] = np.nan, 1e6
    bent = replace(m, tubes=replace(m.tubes, center_px=centers))
    assert len(marks(bent, LATTICE)) == len(m.tubes) - 2


def test_figures_that_are_not_finite_are_told_as_unknown():
    result = made_up()[1]
    m = result.measurement
    vague = replace(m, pose=replace(m.pose, sigma=replace(m.pose.sigma, distance_mm=math.inf)))
    assert frame_head(replace(result, measurement=vague), RULE, None)["pose"]["distance_sigma_mm"] is None


def test_alignment_is_told_in_the_directions_of_the_picture():
    station = FakeStation(aligner=aligner_at(0.6, -0.3))
    head = told(station, *made_up())
    a = head["alignment"]
    assert a["offset_picture_mm"] == pytest.approx([0.6, -0.3], abs=0.05)
    assert a["offset_mm"] == pytest.approx(math.hypot(0.6, 0.3), abs=0.05)
    assert (head["target"], a["place"]) == ([0, 0], [0, 0])
    assert len(a["entry_px"]) == 48
    assert a["quality"] in ("good", "uncertain")


# -- trend -------------------------------------------------------------------------------------------------------------


def test_the_trend_is_thinned_and_forgets_after_a_minute():
    trend = Trend()
    for i in range(700):
        trend.add(i * SECOND // 10, made_up()[1])
        assert trend.add(i * SECOND // 10 + 1, made_up()[1]) is None
    points = trend.since(699 * SECOND // 10)
    assert 595 <= len(points) <= 600
    assert points[0][0] > 9_900
    assert len(points[0]) == 1 + len(FIELDS)


def test_without_a_guide_the_trend_is_that_of_the_camera():
    point = Trend().add(0, made_up()[1])
    assert point == (0.0, None, None, 0.0, 0.08, 400.0, 0.25)


def test_a_clock_that_runs_back_begins_anew():
    trend = Trend()
    assert trend.add(5 * SECOND, made_up()[1]) is not None
    assert trend.add(1 * SECOND, made_up()[1]) is not None


# -- what operators do -------------------------------------------------------------------------------------------------


def test_a_place_belongs_to_the_pictures_it_was_chosen_in():
    station = FakeStation()
    with pytest.raises(RefusedError, match="no picture yet"):
        station.operations.choose("1,1", None, "")
    frame, result = made_up(generation=1)
    station.show(frame, result)
    assert station.operations.choose("1,1", 1, "A") == "1,1"
    assert station.operations.place_in(result) == (1, 1)
    reopened = made_up(generation=2)
    station.show(*reopened)
    assert station.operations.place_in(reopened[1]) is None
    with pytest.raises(RefusedError, match="reopened"):
        station.operations.choose("1,1", 1, "")
    assert station.told == ["target is 1,1, by A"]


def test_a_place_belongs_to_the_lattice_index_it_was_chosen_in():
    station = FakeStation()
    frame, result = made_up()
    station.show(frame, result)
    assert frame_head(station.latest, RULE, None)["index"] == 0
    station.operations.choose("1,1", 1, "", 0)
    slipped = replace(result, measurement=replace(result.measurement, index=3))
    station.show(frame, slipped)
    assert station.operations.place_in(slipped) is None
    with pytest.raises(RefusedError, match="may have slipped"):
        station.operations.choose("1,1", 1, "", 0)
    with pytest.raises(RefusedError, match="may have slipped"):
        station.operations.anchor(0, 0, "ROW12 COL34", 1, "", 0)
    assert station.operations.anchor(0, 0, "ROW12 COL34", 1, "", 3) == "0,0=ROW12 COL34"


def test_a_name_is_a_place_once_an_anchor_says_so():
    station = FakeStation()
    station.show(*made_up())
    station.operations.choose("row 12 col 35", None, "")
    assert station.operations.place_in(station.latest) is None
    station.operations.anchor(0, 0, "ROW12 COL34", 1, "")
    station.show(*made_up())
    assert station.operations.place_in(station.latest) == (0, 1)
    assert station.operations.naming() == {"anchors": ["0,0=ROW12 COL34"], "problem": None}
    for wrong in ("ROW0 COL1", "L1R1", "SG2 ROW1 COL1"):
        with pytest.raises(RefusedError):
            station.operations.anchor(0, 0, wrong, 1, "")


# -- rights ------------------------------------------------------------------------------------------------------------


def test_tokens_are_long_and_new_each_time():
    one, two = Tokens.fresh(), Tokens.fresh()
    assert len({one.view, one.control, two.view, two.control}) == 4
    assert min(map(len, (one.view, one.control))) >= 32


def test_rights_follow_the_tokens():
    access = Access(ConsoleSettings(address="0.0.0.0"), 8420, Tokens("v", "c"))
    rights = [access.right(t) for t in ("c", "v", "x", None, "", "c" * 300)]
    assert rights == [Right.CONTROL, Right.VIEW, *[Right.NONE] * 4]


def test_on_a_network_plain_addresses_and_the_names_given_are_ours():
    access = Access(ConsoleSettings(address="0.0.0.0", names=("station7.plant",)), 8420, Tokens("v", "c"))
    assert all(map(access.is_ours, ("10.0.0.7:8420", "station7.plant:8420", "STATION7.plant:8420", "[fe80::1]:8420")))
    assert not any(
        map(access.is_ours, ("evil.example:8420", "user@10.0.0.7:8420", "10.0.0.7:8420/x", "10.0.0.7:9", None))
    )
    assert not access.is_from_ours("http://[bad", "10.0.0.7:8420")


def test_a_bucket_fills_up_again_and_each_client_has_one():
    clock = ManualClock()
    bucket = Bucket(2.0, 3.0, clock)
    assert [bucket.take() for _ in range(4)] == [True, True, True, False]
    clock.advance(0.5)
    assert [bucket.take() for _ in range(2)] == [True, False]
    buckets = Buckets(1.0, 1.0, clock)
    assert [buckets.take(c) for c in ("a", "a", "b")] == [True, False, True]
    for i in range(1000):
        buckets.take(str(i))
    assert len(buckets._kept) <= 256


# -- the sink ----------------------------------------------------------------------------------------------------------


def test_nothing_is_coded_while_nobody_watches(monkeypatch):
    station = FakeStation()
    monkeypatch.setattr("service.console.sink.frame_message", lambda *_: pytest.fail("coded for nobody"))
    assert station.show(*made_up())
    assert station.board.newest is None


def test_updates_come_no_faster_than_asked_for():
    station = FakeStation(rate_hz=5.0)
    shown = [station.show(*made_up(i)) for i in range(25)]  # one second
    assert 5 <= sum(shown) <= 7


def test_a_board_without_a_loop_takes_messages():
    board = Board()
    board.post(b"1")
    board.post(b"2")
    assert (board.newest.number, board.newest.message) == (2, b"2")


# -- as a whole --------------------------------------------------------------------------------------------------------


def console(clock=None, **settings):
    station = FakeStation()
    about = About("LIVE", "camera", "Model F", RULE, ConsoleSettings(**settings))
    interpreter = Interpreter(TubeNamer(RULE), None)
    return Console(
        about, interpreter, station.watched, None, clock or ManualClock(), AlarmDesk(station.tell), station.tell
    )


def test_the_page_is_served_from_start_to_close_and_its_address_told(capsys):
    made = console()
    made.sink.start()
    try:
        with pytest.raises(Exception, match="in use"):
            bind("127.0.0.1", made.port)
        made.announce()
        assert capsys.readouterr().out == f"operator's page: http://127.0.0.1:{made.port}/\n"
    finally:
        made.sink.close(10.0)
        made.sink.close(1.0)
    bind("127.0.0.1", made.port).close()


def test_on_a_network_both_tokens_are_shown_once(capsys):
    made = console(address="0.0.0.0")
    made.sink.start()
    try:
        made.announce()
    finally:
        made.sink.close(10.0)
    said = capsys.readouterr().out
    assert f"/#token={made.tokens.control}" in said
    assert f"/#token={made.tokens.view}" in said
    assert "to operate" in said
