import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceDisconnectedError
from drivers.range_finder import (
    AcuityRangeFinder,
    DimetixRangeFinder,
    RangeFinder,
    RangeReading,
    acuity_answer,
    dimetix_answer,
)
from drivers.reading import Quality
from drivers.serial_channel import SerialChannel
from tests.fakes.clock import HurriedClock
from tests.fakes.dialogue import ScriptedChannel
from tests.fakes.serial_devices import FakeRangeFinder, PtyLine, SocketLine

ASK_DIMETIX, ASK_ACUITY = b"s0g\r\n", b"DM\r"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"g0g+00012345", 1234.5),
        (b"g0g+00000001", 0.1),
        (b"g0g+00000000", "says 0 mm"),
        (b"g0g-00000500", "says -50 mm"),
        (b"g0@E255", "error E255"),
        (b"g1g+00012345", None),
        (b"g0g+0001234", None),
        (b"0g+00012345", None),
        (b"g0g+00012345 ", None),
        (b"g0?", None),
        (b"g0@E25", None),
        (b"", None),
    ],
)
def test_a_dimetix_line_is_a_distance_an_error_or_nothing(line, answer):
    check(dimetix_answer(line, 0), answer)


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"004.996", 4996.0),
        (b"4.996", 4996.0),
        (b" 4.996 ", 4996.0),
        (b"004.996 000985", 4996.0),
        (b"0.000", "says 0 mm"),
        (b"-0.002", "says -2 mm"),
        (b"E15", "error E15"),
        (b"4.99", None),
        (b"4.9961", None),
        (b"4,996", None),
        (b"1e3.000", None),
        (b"E1", None),
        (b" 001384", None),
        (b"DM", None),
        (b"nan", None),
        (b"", None),
    ],
)
def test_an_acuity_line_is_a_distance_an_error_or_nothing(line, answer):
    check(acuity_answer(line), answer)


def check(found, expected):
    if isinstance(expected, str):
        assert expected in found
    else:
        assert found == expected


@given(st.integers(1, 99_999_999))
def test_every_tenth_of_a_millimetre_is_read_back(tenths):
    assert dimetix_answer(b"g3g+%08d" % tenths, 3) == tenths / 10


@given(st.integers(1, 9_999_999))
def test_every_millimetre_is_read_back(mm):
    assert acuity_answer(f"{mm / 1000:.3f}".encode()) == mm


@given(st.binary(max_size=40))
def test_reading_never_fails_whatever_comes(line):
    for answer in (dimetix_answer(line, 0), acuity_answer(line)):
        assert answer is None or isinstance(answer, str) or answer > 0


def test_a_measurement_has_a_sigma_and_a_time():
    with ScriptedChannel([(ASK_DIMETIX, [0.2, b"g0g+00", 0.1, b"012345\r\n"])]) as channel:
        finder: RangeFinder = DimetixRangeFinder(channel, sigma_mm=0.7)
        assert finder.read() == RangeReading(channel.clock.now_ns, Quality.GOOD, None, 1234.5, 0.7)


def test_a_type_has_its_usual_sigma():
    with ScriptedChannel([(ASK_ACUITY, [b"1.234\r\n"])]) as channel:
        assert AcuityRangeFinder(channel).read().sigma_mm == 3.0


def test_a_device_has_the_number_it_was_given():
    with ScriptedChannel([(b"s7g\r\n", [b"g0g+00000001\r\ng7g+00000002\r\n"])]) as channel:
        assert DimetixRangeFinder(channel, device_id=7).read().distance_mm == 0.2


@pytest.mark.parametrize(
    ("heard", "words"),
    [
        ([b"g0@E255\r\n"], "E255"),
        ([b"g0g+00000000\r\n"], "says 0 mm"),
        ([], "no answer"),
        ([b"g0g+0001"], "but heard b'g0g+0001'"),
        ([DeviceDisconnectedError("scripted", "gone")], "gone"),
        ([b"g0g+0001", DeviceDisconnectedError("scripted", "gone")], "gone"),
    ],
)
def test_an_error_is_bad_quality_and_no_number(heard, words):
    with ScriptedChannel([(ASK_DIMETIX, heard)]) as channel:
        reading = DimetixRangeFinder(channel).read()
    assert words in reading.reason
    assert reading == RangeReading(reading.time_ns, Quality.BAD, reading.reason)


def test_the_tail_of_a_line_is_never_taken_for_a_distance():
    """A device that streams by itself: 14.996 m, of which 4.996 was heard first."""
    with ScriptedChannel([(None, [b"4.996\r\n014.9"]), (ASK_ACUITY, [b"96\r\n"])]) as channel:
        finder = AcuityRangeFinder(channel)
        assert finder.read().quality is Quality.BAD  # the quiet after it broke the line off
    with ScriptedChannel([(None, [b"4.996\r\n014.9", 0.05, b"96\r\n"]), (ASK_ACUITY, [b"014.997\r\n"])]) as channel:
        assert AcuityRangeFinder(channel).read().distance_mm == 14997


@pytest.mark.parametrize(
    ("kind", "says", "bad"),
    [
        (DimetixRangeFinder, b"g0g+00012345\r\n", b"g0@E203\r\n"),
        (AcuityRangeFinder, b"1.2345\r\n1.234\r\n", b"E16\r\n"),
    ],
)
def test_a_range_finder_on_a_pseudo_terminal_measures_errs_is_unplugged_and_found_again(tmp_path, kind, says, bad):
    clock, device = HurriedClock(), FakeRangeFinder(says)
    with PtyLine(tmp_path, device) as line:
        finder = kind(SerialChannel(line.path, kind.usual_line, clock=clock), timeout_s=10.0)
        assert finder.read().quality is Quality.GOOD
        device.says = bad
        assert "reports error" in finder.read().reason
        device.says = says
        assert finder.read().quality is Quality.GOOD
    assert "connection lost" in finder.read().reason
    clock.advance(20)
    with PtyLine(tmp_path, device):
        assert finder.read().quality is Quality.GOOD
        finder.abort()
        assert "ended" in finder.read().reason
        finder.close()


def test_a_mute_range_finder_is_bad_quality(tmp_path):
    with PtyLine(tmp_path, FakeRangeFinder(b"")) as line:
        finder = DimetixRangeFinder(SerialChannel(line.path), timeout_s=0.1)
        assert [finder.read().quality for _ in range(2)] == [Quality.BAD] * 2
        finder.close()


def test_behind_a_socket_too_what_is_left_of_one_answer_is_none_to_the_next():
    with SocketLine(FakeRangeFinder(b"1.234 000985\r\n2.000\r\n")) as line:
        finder = AcuityRangeFinder(SerialChannel(line.path), timeout_s=10.0)
        assert [finder.read().distance_mm for _ in range(5)] == [1234] * 5
        finder.close()
