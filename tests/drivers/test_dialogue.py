import contextlib
import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dialogue import LONGEST_LINE, SILENT_LIMIT, Dialogue, split_lines
from drivers.errors import DeviceDisconnectedError, DeviceTimeoutError
from tests.fakes.dialogue import ScriptedChannel


def ask(channel, dialogue=None, question=b"q"):
    dialogue = dialogue or Dialogue(channel, split_lines, 0.5)
    return dialogue, dialogue.ask(question, lambda line: line.startswith(b"a")).message


def test_an_answer_comes_in_pieces_among_lines_that_answer_nothing():
    with ScriptedChannel([(b"q", [b"x\r\nno", 0.1, b"ne\r\na", 0.1, b"1\r", 0.1, b"\n"])]) as channel:
        dialogue, answer = ask(channel)
        channel.receive(1)
    assert answer == b"a1"
    assert (dialogue.counters.asked, dialogue.counters.answered, dialogue.counters.unexpected) == (1, 1, 2)


def test_times_stand_with_the_answer():
    with ScriptedChannel([(b"q", [0.3, b"a\n"])]) as channel:
        reply = Dialogue(channel, split_lines, 0.5).ask(b"q", lambda line: True)
    assert reply.received_ns - reply.sent_ns == pytest.approx(0.3e9)


def test_what_was_said_before_the_question_is_no_answer_to_it():
    with ScriptedChannel([(b"q", [b"a1\na2\nhalf a"]), (b"r", [b"gone\na3\n"])]) as channel:
        dialogue, first = ask(channel)
        _, second = ask(channel, dialogue, b"r")
    assert (first, second) == (b"a1", b"a3")


def test_an_answer_that_comes_late_does_not_pass_for_the_next():
    with ScriptedChannel([(b"q", [0.7, b"a1\n"]), (b"r", [0.1, b"a2\n"])]) as channel:
        dialogue = Dialogue(channel, split_lines, 0.5)
        with pytest.raises(DeviceTimeoutError, match=r"no answer within 0\.5 s; is the device on\?"):
            ask(channel, dialogue)
        assert ask(channel, dialogue, b"r")[1] == b"a2"
    assert dialogue.counters.unanswered == 1


def test_a_line_opened_in_mid_message_is_heard_out_first():
    with ScriptedChannel([(None, [b"4.9", 0.05, b"96\n"]), (b"q", [b"a\n"])]) as channel:
        assert ask(channel)[1] == b"a"


def test_a_device_that_never_stops_is_asked_all_the_same_and_only_whole_lines_are_taken():
    talk = [piece for _ in range(8) for piece in (0.04, b"5\na")]
    with ScriptedChannel([(None, talk), (b"q", [b"b5\na6\n"])]) as channel:
        assert ask(channel)[1] == b"ab5"


def test_what_was_heard_instead_of_an_answer_is_told():
    with ScriptedChannel([(b"q", [b"\x80\x8a\n"])]) as channel, pytest.raises(DeviceTimeoutError, match=r"\\x80\\x8a"):
        ask(channel)


def test_a_line_lost_in_mid_question_is_passed_on_and_begun_anew():
    lost = DeviceDisconnectedError("scripted", "gone")
    with ScriptedChannel([(b"q", [b"half", lost]), (b"q", [lost]), (b"q", [b"a\n"])]) as channel:
        dialogue = Dialogue(channel, split_lines, 0.5)
        for _ in range(2):
            with pytest.raises(DeviceDisconnectedError):
                ask(channel, dialogue)
            channel.lines += 1
        assert ask(channel, dialogue)[1] == b"a"


def test_a_line_on_which_nobody_answers_is_opened_anew_in_the_end_and_then_has_as_long_again():
    nearly = [(b"q", [])] * (SILENT_LIMIT - 1)
    script = [*nearly, (b"q", [b"a\n"]), *nearly, (b"q", []), *nearly, (b"q", [])]
    drops = []
    with ScriptedChannel(script) as channel:
        dialogue = Dialogue(channel, split_lines, 0.5)
        for _ in range(len(script)):
            with contextlib.suppress(DeviceTimeoutError):
                ask(channel, dialogue)
            drops.append(len(channel.dropped))
    assert [drops.index(1) + 1, drops.index(2) + 1] == [2 * SILENT_LIMIT, 3 * SILENT_LIMIT]


@given(st.binary(max_size=400), st.lists(st.integers(0, 400)))
def test_lines_are_the_same_however_their_bytes_arrive(data, cuts):
    lines, rest = [], b""
    edges = sorted({0, len(data), *(c for c in cuts if c <= len(data))})
    for start, end in itertools.pairwise(edges):
        more, rest = split_lines(rest + data[start:end])
        lines += more
        assert len(rest) <= LONGEST_LINE
    whole = [line for line in data.replace(b"\r", b"\n").split(b"\n")[:-1] if line]
    assert [line[-LONGEST_LINE:] for line in lines] == [line[-LONGEST_LINE:] for line in whole]
