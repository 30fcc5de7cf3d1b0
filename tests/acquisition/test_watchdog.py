import pytest

from service.acquisition.watchdog import Call, is_hung, is_stalled, silence_limit_s
from service.config.supervision import SupervisionSettings

SETTINGS = SupervisionSettings()


@pytest.mark.parametrize(
    ("rate_hz", "started", "limit_s"),
    [(30.0, True, 0.45), (5.0, True, 0.9), (None, True, 0.45), (30.0, False, 3.0), (1.0, False, 4.5)],
)
def test_a_stall_is_noticed_within_five_frames_or_half_a_second(rate_hz, started, limit_s):
    assert silence_limit_s(SETTINGS, rate_hz, started=started) == pytest.approx(limit_s)


def test_a_stall_begins_at_the_limit():
    assert not is_stalled(1_449_999_999, 1_000_000_000, 0.45)
    assert is_stalled(1_450_000_000, 1_000_000_000, 0.45)


def test_a_call_hangs_when_it_is_overdue_by_so_much():
    call = Call("reading", 0, 0.1)
    assert not is_hung(3_100_000_000, call, 3.0)
    assert is_hung(3_100_000_001, call, 3.0)
    assert not is_hung(10**12, None, 3.0)
