"""Whatever a device does, in whatever order: every number is delivered or lost, and nothing is left open."""

import numpy as np
import pytest

from drivers.errors import DeviceDisconnectedError, DeviceProtocolError, DeviceTimeoutError
from drivers.grabber import FieldMode
from tests.fakes.clock import ManualClock
from tests.fakes.kernel import fake_grabber, picture

KINDS = ("drop", "error", "short", "empty", "eio", "hang", "gone", "spurious")


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("mode", [FieldMode.FRAME, FieldMode.ALTERNATE])
def test_every_number_is_delivered_or_lost_and_sound_frames_are_right(seed, mode):
    rng, clock = np.random.default_rng(seed), ManualClock()
    grabber, device = fake_grabber(clock, grabber={"field_mode": mode, "buffers": 4})
    for _ in range(20):
        device.faults = {int(at): str(rng.choice(KINDS)) for at in rng.integers(0, 60, 12)}
        with grabber:
            grabber.start()
            numbers = list(stream(grabber, clock, rng, mode))
            c = grabber.counters
            assert c.completed == len(numbers)
            if numbers:
                span = numbers[-1] - numbers[0] + 1
                assert len(set(numbers)) + c.lost == span
        device.gone = False
        assert grabber._system.fds == {}
    assert all(memory.closed for memory in device.mapped)


def stream(grabber, clock, rng, mode):
    for _ in range(80):
        try:
            frame = grabber.read(float(rng.choice([0.0, 0.01, 0.5])))
        except DeviceTimeoutError:
            continue
        except (DeviceDisconnectedError, DeviceProtocolError):
            return
        if frame.defect is None:
            parity = slice(None) if mode is FieldMode.FRAME else slice(int(frame.field == "bottom"), None, 2)
            np.testing.assert_array_equal(frame.pixels, picture(frame.sequence)[parity])
        clock.advance(float(rng.choice([0, 0, 0, 0.3])))
        yield frame.sequence
