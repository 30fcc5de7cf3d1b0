"""The soak's own arithmetic: it sees what grows, and does not see what only wavers."""

from types import SimpleNamespace

import numpy as np
import pytest

from service.acquisition.ledger import Account
from tests.bench.soak import slope_mb_per_h, told

TIMES_S = np.arange(180.0)


def samples(mb_per_h=0.0, waver_mb=0.0, leap_mb=0.0, fds=20, fds_at_end=20, seconds=180):
    rng, times_s = np.random.default_rng(0), np.arange(float(seconds))
    rss = 250e6 + mb_per_h * 1e6 * times_s / 3600 + 1e6 * waver_mb * rng.normal(size=seconds)
    rss += 1e6 * leap_mb * (times_s > 0.6 * seconds)
    fds = np.where(times_s < seconds - 10, fds, fds_at_end)
    return np.column_stack([times_s, rss, fds, np.full(seconds, 12)])


HEALTH = SimpleNamespace(account=Account(), recoveries=0)


def test_a_slope_is_found_with_its_sigma():
    slope, sigma = slope_mb_per_h(TIMES_S, 1e6 * (250 + TIMES_S / 600))
    assert slope == pytest.approx(6.0)
    assert sigma == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("values", "status"),
    [
        ({}, 0),
        ({"waver_mb": 0.5}, 0),
        ({"leap_mb": 1.0}, 0),
        ({"leap_mb": 0.5, "mb_per_h": 40.0}, 1),
        ({"mb_per_h": 0.8}, 0),
        ({"mb_per_h": 5.0}, 0),
        ({"mb_per_h": 9.0}, 1),
        ({"mb_per_h": 1.2, "seconds": 3600}, 1),
        ({"mb_per_h": 60.0, "waver_mb": 0.1}, 1),
        ({"fds_at_end": 21}, 1),
        ({"fds_at_end": 19}, 0),
    ],
)
def test_what_grows_fails(values, status, capsys):
    assert told(samples(**values), 60.0, HEALTH) == status
    assert "MB/h" in capsys.readouterr().out


def test_a_frame_unaccounted_for_fails():
    health = SimpleNamespace(account=Account(span=1), recoveries=0)
    assert told(samples(), 60.0, health) == 1
