import numpy as np
import pytest

from service.vision.motion import Motion

T = np.array([0.0, 0.0, 700.0])
STEP = np.array([3.0, 0.0, 0.0])
PERIOD_NS = 33_366_667


def moved(after_ns):
    first = Motion.standing(np.eye(3), T, 0, np.zeros(2)).moved_to(np.eye(3), T + STEP, PERIOD_NS, np.zeros(2))
    return first, first.moved_to(np.eye(3), T + 2 * STEP, PERIOD_NS + after_ns, np.zeros(2))


@pytest.mark.parametrize("after_ns", [-PERIOD_NS // 2, 0, 1, 900_000])
def test_pictures_at_the_same_time_tell_no_speed(after_ns):
    """A nanosecond between two fields, over a passed frame, made a speed of a thousand kilometres a second."""
    before, now = moved(after_ns)
    assert np.array_equal(now.speed_mm_per_s, before.speed_mm_per_s)
    assert np.array_equal(now.translation_mm, T + 2 * STEP)


def test_a_period_between_them_does():
    _, now = moved(PERIOD_NS // 2)
    assert now.speed_mm_per_s == pytest.approx(STEP / (PERIOD_NS // 2 * 1e-9))
