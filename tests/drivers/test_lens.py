import logging

import pytest

from drivers.errors import DeviceDisconnectedError, DeviceProtocolError, DeviceStateError, DeviceTimeoutError
from drivers.lens import Lens, LensState, ViscaLens
from drivers.reading import Quality
from drivers.serial_channel import SerialChannel
from tests.fakes.clock import HurriedClock
from tests.fakes.dialogue import ScriptedChannel
from tests.fakes.serial_devices import FakeCamera, PtyLine, SocketLine

GREETING = [
    (bytes.fromhex("883001FF"), [bytes.fromhex("883002FF")]),
    (bytes.fromhex("88010001FF"), [bytes.fromhex("88010001FF")]),
]
ZOOM = bytes.fromhex("81090447FF"), [bytes.fromhex("90500107 0801FF")]
ASK_BLOCK = bytes.fromhex("81097E7E00FF")
QUIET = ASK_BLOCK, [bytes.fromhex("90 50 01070801 0000 0A0B0C0D 00 00 00 FF")]
AUTOFOCUS_OFF = bytes.fromhex("8101043803FF")


def block(mode, executing=0):
    return ASK_BLOCK, [bytes.fromhex("90 50 01070801 0000 0A0B0C0D 00") + bytes((mode, executing, 0xFF))]


def test_a_reading_is_two_inquiries_on_a_line_that_was_greeted_once():
    with ScriptedChannel([*GREETING, ZOOM, QUIET, ZOOM, QUIET]) as channel:
        lens: Lens = ViscaLens(channel)
        first, second = lens.read(), lens.read()
    assert first == LensState(first.time_ns, Quality.GOOD, None, 0x1781, 0xABCD, False, False, False)
    assert second.quality is Quality.GOOD


def test_a_line_opened_anew_is_greeted_anew():
    with ScriptedChannel([*GREETING, ZOOM, QUIET, *GREETING, ZOOM, QUIET]) as channel:
        lens = ViscaLens(channel)
        lens.read()
        channel.drop("test")
        assert lens.read().quality is Quality.GOOD


def test_a_camera_that_knows_no_greeting_is_read_all_the_same():
    deaf = [(GREETING[0][0], [bytes.fromhex("906002FF")]), (GREETING[1][0], [])]
    with ScriptedChannel([*deaf, ZOOM, QUIET]) as channel:
        assert ViscaLens(channel).read().quality is Quality.GOOD


@pytest.mark.parametrize("executing", [1, 2, 4])
def test_a_lens_under_way_says_so(executing):
    with ScriptedChannel([*GREETING, ZOOM, block(0, executing)]) as channel:
        assert ViscaLens(channel).read().executing


@pytest.mark.parametrize(
    ("heard", "words"),
    [
        ([], "no answer within"),
        ([bytes.fromhex("906141FF")], "not executable in this state (41h)"),
        ([bytes.fromhex("906002FF")], "syntax error (02h)"),
        ([bytes.fromhex("A050 01070801FF")], "but heard"),
        ([bytes.fromhex("9050 010708FF")], "but heard"),
        ([bytes.fromhex("9050 11070801FF")], "but heard"),
        ([bytes.fromhex("9050 0107"), DeviceDisconnectedError("scripted", "gone")], "gone"),
    ],
)
def test_an_error_or_a_wrong_answer_is_bad_quality_and_no_number(heard, words):
    with ScriptedChannel([*GREETING, (ZOOM[0], heard)]) as channel:
        state = ViscaLens(channel).read()
    assert words in state.reason
    assert state == LensState(state.time_ns, Quality.BAD, state.reason)


def test_a_late_zoom_position_is_not_taken_for_the_next():
    late = ZOOM[0], [0.6, bytes.fromhex("9050 00000000FF")]
    with ScriptedChannel([*GREETING, late, ZOOM, QUIET]) as channel:
        lens = ViscaLens(channel)
        assert lens.read().quality is Quality.BAD
        assert lens.read().zoom_position == 0x1781


def test_what_moves_by_itself_is_switched_off_once_it_is_found_on(caplog):
    off = [
        (AUTOFOCUS_OFF, [bytes.fromhex("9041FF"), 0.1, bytes.fromhex("9051FF")]),
        (bytes.fromhex("8101040603FF"), [bytes.fromhex("9051FF")]),
    ]
    with ScriptedChannel([*GREETING, ZOOM, block(3), *off, ZOOM, QUIET]) as channel:
        lens = ViscaLens(channel)
        state = lens.read()
        assert (state.autofocus, state.digital_zoom) == (True, True)
        state = lens.read()
        assert (state.autofocus, state.digital_zoom) == (False, False)
    assert "autofocus was on; switched off" in caplog.text
    assert "digital zoom was on; switched off" in caplog.text


def test_a_camera_that_refuses_is_still_read_and_asked_again_only_after_a_while(caplog):
    refusal = AUTOFOCUS_OFF, [bytes.fromhex("9041FF 906141FF")]
    with ScriptedChannel([*GREETING, ZOOM, block(1), refusal, ZOOM, block(1), ZOOM, block(1), refusal]) as channel:
        lens = ViscaLens(channel)
        for wait_s in (1, 10, 0):
            assert lens.read().autofocus is True
            channel.clock.advance(wait_s)
    assert [r.levelno for r in caplog.records] == [logging.WARNING] * 2
    assert "not executable" in caplog.text
    assert "autofocus stays on" in caplog.text


def test_what_is_wanted_on_stays_on():
    with ScriptedChannel([*GREETING, ZOOM, block(3)]) as channel:
        ViscaLens(channel, autofocus_off=False, digital_zoom_off=False).read()


@pytest.mark.parametrize(
    ("heard", "kind"),
    [
        ([], DeviceTimeoutError),
        ([bytes.fromhex("9041FF")], DeviceTimeoutError),
        ([bytes.fromhex("906002FF")], DeviceProtocolError),
        ([bytes.fromhex("906003FF")], DeviceStateError),
        ([bytes.fromhex("9041FF 9041FF")], DeviceTimeoutError),
        ([bytes.fromhex("9050 02FF A051FF")], DeviceTimeoutError),
    ],
)
def test_a_command_that_is_not_completed_fails(heard, kind):
    with ScriptedChannel([(AUTOFOCUS_OFF, heard)]) as channel, pytest.raises(kind):
        ViscaLens(channel).set_autofocus(False)


def test_ending_and_closing_reach_the_line():
    channel = ScriptedChannel()
    lens = ViscaLens(channel)
    lens.abort()
    lens.close()
    assert (channel.aborted, channel.closed) == (1, 1)


# -- a camera on a real line -------------------------------------------------------------------------------------------


def test_a_camera_on_a_pseudo_terminal_is_read_muted_garbled_unplugged_and_found_again(tmp_path):
    clock, camera = HurriedClock(), FakeCamera(zoom=0x1781)
    with PtyLine(tmp_path, camera) as line:
        lens = ViscaLens(SerialChannel(line.path, clock=clock), timeout_s=10.0)
        assert lens.read().zoom_position == 0x1781
        assert (camera.autofocus, camera.digital_zoom) == (False, False)
        camera.zoom, camera.noise = 0x2000, b"\x00\xff\x90\x50\x01"
        assert lens.read().zoom_position == 0x2000
        camera.error = 0x41
        assert "not executable" in lens.read().reason
        camera.error = None
    assert "connection lost" in lens.read().reason
    clock.advance(20)
    assert "no such port" in lens.read().reason
    clock.advance(20)
    camera.autofocus = True
    with PtyLine(tmp_path, camera):
        assert lens.read().zoom_position == 0x2000
        assert not camera.autofocus
        lens.close()


def test_a_mute_camera_is_bad_quality_until_it_speaks(tmp_path):
    camera = FakeCamera()
    camera.mute = True
    with PtyLine(tmp_path, camera) as line:
        lens = ViscaLens(SerialChannel(line.path), timeout_s=0.1)
        assert "no answer within" in lens.read().reason
        camera.mute = False
        states = [lens.read() for _ in range(50)]
        assert any(state.quality is Quality.GOOD for state in states)
        lens.close()


def test_a_camera_behind_a_socket_is_read_and_found_again():
    clock, camera = HurriedClock(), FakeCamera()
    with SocketLine(camera) as line:
        lens = ViscaLens(SerialChannel(line.path, clock=clock), timeout_s=10.0)
        assert lens.read().quality is Quality.GOOD
        line.hang_up()
        while (state := lens.read()).quality is Quality.GOOD:
            pass
        assert "connection lost" in state.reason
        clock.advance(20)
        assert lens.read().quality is Quality.GOOD
        lens.close()
