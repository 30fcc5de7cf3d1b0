import random

import pytest

from drivers.errors import (
    ConfigError,
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceProtocolError,
    DeviceStateError,
    DeviceTimeoutError,
    UnsupportedFormatError,
)
from service.acquisition.ladder import Rung, Trouble, jittered, next_step, trouble_of
from service.config.supervision import SupervisionSettings

SETTINGS = SupervisionSettings()


def steps(trouble, count, *, streams=True, may_reset=False):
    found = [next_step(trouble, i, SETTINGS, streams=streams, may_reset=may_reset) for i in range(count)]
    return [s.rung for s in found], [s.pause_s for s in found]


@pytest.mark.parametrize(
    ("error", "trouble"),
    [
        (DeviceTimeoutError, Trouble.STALL),
        (DeviceDisconnectedError, Trouble.GONE),
        (DeviceNotFoundError, Trouble.ABSENT),
        (DeviceBusyError, Trouble.REFUSED),
        (DevicePermissionError, Trouble.REFUSED),
        (DeviceStateError, Trouble.REFUSED),
        (UnsupportedFormatError, Trouble.REFUSED),
        (DeviceProtocolError, Trouble.FAULT),
        (DeviceError, Trouble.FAULT),
    ],
)
def test_every_error_of_a_device_has_a_trouble(error, trouble):
    assert trouble_of(error("fake", "words")) is trouble


def test_a_driver_s_own_mistake_is_a_fault_and_a_wrong_setting_is_final():
    assert trouble_of(RuntimeError("a mistake")) is Trouble.FAULT
    assert trouble_of(ConfigError("1024x768: wrong")) is None


def test_a_stall_climbs_the_whole_ladder():
    rungs, pauses = steps(Trouble.STALL, 5, may_reset=True)
    assert rungs == [Rung.RESTART, Rung.REOPEN, Rung.SEARCH, Rung.RESET, Rung.RESET]
    assert pauses == [0.0, 0.25, 0.5, 1.0, 2.0]


def test_without_leave_nothing_is_reset():
    assert steps(Trouble.STALL, 9)[0][-1] is Rung.SEARCH


def test_what_does_not_stream_is_not_restarted():
    assert steps(Trouble.STALL, 1, streams=False)[0] == [Rung.REOPEN]


def test_pauses_double_up_to_the_longest_however_often_it_failed():
    pauses = steps(Trouble.REFUSED, 5000)[1]
    assert pauses[:7] == [0.25, 0.25, 0.5, 1.0, 2.0, 4.0, 5.0]
    assert pauses[-1] == 5.0


def test_what_is_not_there_is_looked_for_steadily_so_that_it_is_found_in_time():
    for trouble in (Trouble.GONE, Trouble.ABSENT):
        rungs, pauses = steps(trouble, 50, streams=False, may_reset=True)
        assert set(rungs) == {Rung.SEARCH}
        assert max(pauses) == SETTINGS.look_s


def test_a_hung_device_is_reset_at_once_where_that_is_allowed():
    assert steps(Trouble.HUNG, 1, streams=False, may_reset=True) == ([Rung.RESET], [0.25])
    assert steps(Trouble.HUNG, 1, streams=False)[0] == [Rung.SEARCH]


def test_chance_shortens_a_pause_by_a_quarter_at_most():
    pauses = [jittered(4.0, random.Random(i)) for i in range(100)]
    assert 3.0 <= min(pauses) < 3.2
    assert 3.8 < max(pauses) <= 4.0


def test_every_rung_has_its_words():
    assert [r.words for r in Rung] == [
        "restarting the stream", "opening it again", "looking for it", "resetting it on its bus",
    ]  # fmt: skip
