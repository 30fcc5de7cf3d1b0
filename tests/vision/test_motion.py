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


def seen_at(positions_mm):
    """The motion after a sheet was seen at these places, a period apart."""
    motion = Motion.standing(np.eye(3), T + np.array([positions_mm[0], 0, 0]), 0, np.zeros(2))
    for k, x in enumerate(positions_mm[1:], 1):
        motion = motion.moved_to(np.eye(3), T + np.array([x, 0, 0]), k * PERIOD_NS, np.zeros(2))
    return motion


def predicted_mm(positions_mm):
    return seen_at(positions_mm).at(len(positions_mm) * PERIOD_NS)[1][0]


def test_an_arm_that_speeds_up_is_thought_to_go_on_doing_so():
    assert predicted_mm([0.5 * k * k for k in range(8)]) == pytest.approx(0.5 * 8 * 8)


def test_one_at_constant_speed_is_not():
    assert predicted_mm([3.0 * k for k in range(8)]) == pytest.approx(24.0)


def test_a_shaken_one_is_predicted_at_its_last_speed():
    """To let speeds grow would make three times as much of what shakes it."""
    shaken = [2.0 * k + (0.3 if k % 2 else -0.3) for k in range(9)]
    assert predicted_mm(shaken) == pytest.approx(2 * shaken[-1] - shaken[-2])


def test_a_turn_that_grows_is_predicted_too():
    def turned(deg):
        a = np.radians(deg)
        return np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])

    motion = Motion.standing(turned(0.0), T, 0, np.zeros(2))
    for k in range(1, 7):
        motion = motion.moved_to(turned(0.2 * k * k), T, k * PERIOD_NS, np.zeros(2))
    assert motion.at(7 * PERIOD_NS)[0] == pytest.approx(turned(0.2 * 49), abs=1e-9)


def test_after_an_outage_the_speed_is_the_last_one():
    """A second of a speed that goes on growing would lead to other tubes."""
    motion = seen_at([0.5 * k * k for k in range(8)])
    assert motion.grows
    x = motion.at(7 * PERIOD_NS + 10**9)[1][0]
    assert x == pytest.approx(0.5 * 49 + 6.5 * 1e9 / PERIOD_NS)
