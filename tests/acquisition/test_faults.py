"""Whatever a device does wrong, the ledger balances after it and agrees with the device's own account."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers.faults import Fault, FaultKind, random_faults
from drivers.grabber import FieldMode
from service.acquisition.liveness import Liveness
from service.acquisition.resources import resources
from tests.bench.faults import run
from tests.fakes.scripted import PATIENCE_S

FOREVER = float("inf")


def played(*faults, frames=60, **options):
    return run(faults, frames, patience_s=PATIENCE_S * 6, **options)


@pytest.mark.parametrize("kind", FaultKind)
@pytest.mark.parametrize("field_mode", [FieldMode.FRAME, FieldMode.ALTERNATE])
def test_every_kind_of_fault_is_accounted_for(kind, field_mode):
    grabber, health, _ = played(Fault(kind, 20, frames=8, seconds=1.5), field_mode=field_mode)
    assert grabber.record.struck[kind] == 1
    assert health.account.delivered > 30


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (Fault(FaultKind.DISCONNECT, 20, seconds=3), "was unplugged"),
        (Fault(FaultKind.HANG, 20, seconds=FOREVER), "no frame for 0.5 s; restarting the stream"),
        (Fault(FaultKind.DELAY, 20, seconds=2), "restarting the stream"),
    ],
)  # fmt: skip
def test_what_stops_the_stream_is_told_and_got_over(fault, words):
    _, health, events = played(fault)
    assert any(words in text for text, _ in events)
    assert any("streams again" in text for text, _ in events)
    assert health.recoveries == 1
    assert health.generation > 1


@pytest.mark.parametrize(("kind", "words"), [(FaultKind.FREEZE, "frozen"), (FaultKind.BLACK, "even grey")])
def test_pictures_of_nothing_are_never_measured(kind, words):
    _, health, _ = played(Fault(kind, 20, frames=20))
    assert 15 <= health.account.corrupt <= 20, words


def test_late_readers_lose_frames_to_the_device_and_it_is_known_how_many():
    grabber, health, _ = played(frames=3000, late_share=0.02)
    assert grabber.record.overrun > 100
    assert health.account.lost > 0


@pytest.mark.parametrize("seed", [1, 2])
def test_any_mixture_is_accounted_for(seed):
    frames = 6000
    faults = random_faults(np.random.default_rng(seed), frames, 0.03, most_seconds=2.0)
    _, health, _ = played(*faults, frames=frames, late_share=0.002)
    assert health.recoveries > 5


@pytest.mark.slow
@pytest.mark.parametrize(("leak_bytes", "status"), [(0, 0), (10_000, 1)])
def test_a_thousand_replugs_leave_nothing_behind_and_what_they_left_would_be_found(leak_bytes, status):
    done = subprocess.run(
        [sys.executable, "-m", "tests.bench.replugs", "--leak", str(leak_bytes)],
        check=False, capture_output=True, text=True, cwd=Path(__file__).parents[2],
    )  # fmt: skip
    assert done.returncode == status, done.stdout + done.stderr
    assert "1,000 replugs" in done.stdout
    assert "files +0, threads +0" in done.stdout


def test_resources_that_the_system_does_not_tell_are_unknown(tmp_path):
    assert resources(tmp_path).rss_bytes is None
    assert resources().threads >= 1
    assert resources().fds > 2


def test_the_state_at_the_end_is_that_it_was_stopped():
    assert played()[1].shown.liveness is Liveness.ENDED
