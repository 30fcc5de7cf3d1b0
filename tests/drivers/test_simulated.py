"""The simulated device: its pace, buffers, inputs and controls, and each of its faults, all of them counted."""

import math
from collections import Counter

import numpy as np
import pytest

from drivers.errors import DeviceDisconnectedError, DeviceNotFoundError, DeviceStateError, DeviceTimeoutError
from drivers.faults import Fault, FaultKind, random_faults
from drivers.frame import Field
from drivers.grabber import AcquisitionMode, FieldMode, GrabberState, SignalStatus, Standard
from drivers.scene import CLEAN, GENERATORS
from drivers.sequence import SEQUENCE_NUMBERS, SequenceExtender
from drivers.simulated import SimulatedGrabber
from drivers.simulation import default_scene
from tests.fakes.clock import ManualClock

PERIOD_NS = 40_000_000


def make_scene(**options):
    return default_scene(
        GENERATORS["model-f"], np.random.default_rng(1), size_px=(64, 48), frames=7, look=CLEAN, **options
    )


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture
def make(scene):
    made = []

    def device(*faults, scene=scene, **options):
        grabber = SimulatedGrabber(scene, loop_frames=8, faults=faults, clock=ManualClock(), **options)
        made.append(grabber)
        return grabber

    yield device
    for grabber in made:
        grabber.close()


def streaming(grabber, mode=AcquisitionMode.CONTINUOUS):
    return grabber.open().start(mode)


def read(grabber, count):
    return [grabber.read(10.0) for _ in range(count)]


def assert_balanced(grabber):
    """Every frame that the device numbered is accounted for, and the grabber's counters agree."""
    grabber.stop()
    r = grabber.record
    assert r.exposed == r.delivered - r.repeated + r.dropped + r.overrun + r.discarded


# -- pace and buffers --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [1.0, 4.0, 0.5])
def test_frames_come_at_the_device_s_pace(make, speed):
    grabber = streaming(make(speed=speed))
    began_ns = grabber.clock.monotonic_ns()
    frames = read(grabber, 5)
    expected = [began_ns + round(PERIOD_NS / speed) * (i + 1) for i in range(5)]
    assert [f.timestamp_ns for f in frames] == expected
    assert [f.received_ns for f in frames] == pytest.approx(expected, abs=10)
    assert grabber.format.rate_hz == 25 * speed


def test_running_free_it_waits_for_nothing(make):
    grabber = streaming(make(speed=math.inf))
    began_ns = grabber.clock.monotonic_ns()
    assert [f.sequence for f in read(grabber, 100)] == list(range(100))
    assert grabber.clock.monotonic_ns() == began_ns
    assert grabber.format.rate_hz is None


def test_a_late_reader_finds_the_oldest_buffers_and_the_rest_lost(make):
    grabber = streaming(make(buffers=3))
    read(grabber, 2)
    grabber.clock.advance(1.0)  # 25 frames
    frames = read(grabber, 5)
    assert [f.sequence for f in frames] == [2, 3, 4, 27, 28]
    assert grabber.counters.lost == 22
    assert grabber.record.overrun == 22
    assert_balanced(grabber)


def test_stopping_forgets_what_was_not_read(make):
    grabber = streaming(make())
    read(grabber, 1)
    grabber.clock.advance(0.1)
    grabber.read(0.0)
    assert_balanced(grabber)
    assert grabber.record.discarded == 1
    grabber.start()
    assert grabber.read(1.0).sequence == 0


def test_the_loop_goes_there_and_back_without_a_seam(make, scene):
    grabber = streaming(make(speed=math.inf))
    shown = [grabber.scene_number(f.pixels) for f in read(grabber, 30)]
    assert shown == [0, 1, 2, 3, 4, 5, 6, 7, 6, 5, 4, 3, 2, 1, 0, 1, 2, 3, 4, 5, 6, 7, 6, 5, 4, 3, 2, 1, 0, 1]
    np.testing.assert_array_equal(grabber.read(1.0).pixels, scene.picture(2))
    assert grabber.scene_number(np.zeros((48, 64), np.uint8)) is None


def test_an_interlaced_loop_keeps_its_fields_in_time_on_the_way_back(make):
    interlaced = make_scene(interlaced=True)
    grabber = streaming(make(scene=interlaced, speed=math.inf))
    frames = read(grabber, 15)
    assert {f.field for f in frames} == {Field.INTERLACED_TOP_FIRST}
    assert [grabber.scene_number(f.pixels) for f in frames] == [*range(14), 0]
    np.testing.assert_array_equal(frames[10].pixels, interlaced.picture(10))


def test_a_field_is_handed_over_when_it_was_exposed(make):
    grabber = streaming(make(field_mode=FieldMode.ALTERNATE))
    top, bottom = read(grabber, 2)
    assert bottom.received_ns - top.received_ns == pytest.approx(PERIOD_NS / 2, abs=10)
    with pytest.raises(DeviceTimeoutError):
        grabber.read(0.01)
    assert grabber.read(0.02).field is Field.TOP


@pytest.mark.parametrize("wrong", [{"speed": 0.0}, {"speed": math.nan}, {"buffers": 0}, {"loop_frames": 0}])
def test_impossible_settings_are_refused(scene, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SimulatedGrabber(scene, **wrong)


# -- inputs, standard, controls ----------------------------------------------------------------------------------------


def test_four_inputs_show_different_pictures_and_one_has_no_signal(make):
    grabber = streaming(make())
    assert [i.name for i in grabber.inputs] == ["CH1", "CH2", "CH3", "CH4"]
    pictures, status = [], []
    for name in ("CH1", "CH2", "CH3", "CH4"):
        grabber.select_input(name)
        status.append(grabber.signal_status())
        pictures.append(grabber.read(1.0).pixels)
    assert status == [SignalStatus.OK] * 3 + [SignalStatus.NO_SIGNAL]
    assert len({p.tobytes() for p in pictures}) == 4
    assert np.ptp(pictures[3]) == 0
    assert [f.sequence for f in read(grabber, 2)] == [4, 5]


def test_a_standard_brings_its_rate_and_needs_a_pause(make):
    grabber = make()
    grabber.open()
    for standard, rate in [(Standard.NTSC, 30000 / 1001), (Standard.PAL, 25.0), (Standard.NONE, 25.0)]:
        grabber.set_standard(standard)
        assert grabber.format.rate_hz == pytest.approx(rate)
    grabber.set_standard(Standard.NTSC)
    grabber.start()
    a, b = read(grabber, 2)
    assert b.timestamp_ns - a.timestamp_ns == pytest.approx(33_366_667, abs=1)
    with pytest.raises(DeviceStateError, match="stop it"):
        grabber.set_standard(Standard.PAL)
    assert grabber.standard is Standard.NTSC


def test_brightness_and_contrast_change_the_picture_and_can_be_taken_back(make):
    grabber = streaming(make(speed=math.inf))
    (plain,) = (f.pixels.astype(int) for f in read(grabber, 1))
    read(grabber, 13)  # the loop is round
    grabber.set_control("brightness", 148)
    brighter = grabber.read(1.0).pixels
    np.testing.assert_allclose(brighter, np.clip(plain + 20, 0, 255), atol=1)
    assert not brighter.flags.writeable
    grabber.set_control("brightness", 128)
    grabber.set_control("contrast", 64)
    read(grabber, 13)
    np.testing.assert_allclose(grabber.read(1.0).pixels, (plain - 127.5) / 2 + 127.5, atol=1)
    grabber.set_control("contrast", 128)
    read(grabber, 13)
    np.testing.assert_array_equal(grabber.read(1.0).pixels, plain)


def test_a_control_takes_whole_steps_and_no_nonsense(make):
    grabber = make().open()
    assert grabber.set_control("hue", 17.4) == 17
    with pytest.raises(DeviceStateError, match="hue=nan"):
        grabber.set_control("hue", math.nan)
    assert grabber.control("hue") == 17


# -- faults ------------------------------------------------------------------------------------------------------------


def test_dropped_frames_are_a_gap(make):
    grabber = streaming(make(Fault(FaultKind.DROP, 3, frames=2)))
    assert [f.sequence for f in read(grabber, 5)] == [0, 1, 2, 5, 6]
    assert (grabber.counters.lost, grabber.record.dropped) == (2, 2)
    assert_balanced(grabber)


def test_a_repeated_frame_comes_again_number_and_all(make):
    grabber = streaming(make(Fault(FaultKind.REPEAT, 2, frames=2)))
    frames = read(grabber, 6)
    assert [f.sequence for f in frames] == [0, 1, 2, 2, 2, 3]
    assert len({f.timestamp_ns for f in frames}) == 4
    assert grabber.record.repeated == 2
    assert grabber.counters.lost == 0
    assert_balanced(grabber)


@pytest.mark.parametrize("speed", [1.0, math.inf])
def test_a_delayed_frame_is_late_but_in_order_and_its_time_is_true(make, speed):
    grabber = streaming(make(Fault(FaultKind.DELAY, 2, seconds=0.1), speed=speed))
    frames = read(grabber, 2)
    with pytest.raises(DeviceTimeoutError):
        grabber.read(0.09)
    frames += read(grabber, 4)
    assert [f.sequence for f in frames] == list(range(6))
    assert [f.timestamp_ns - frames[0].timestamp_ns for f in frames] == [PERIOD_NS * i for i in range(6)]
    if math.isfinite(speed):
        lateness = [(f.received_ns - f.timestamp_ns) / 1e9 for f in frames]
        assert lateness == pytest.approx([0, 0, 0.1, 0.06, 0.02, 0], abs=1e-6)
    assert_balanced(grabber)


def test_a_truncated_frame_has_a_defect_and_no_lower_half(make):
    grabber = streaming(make(Fault(FaultKind.TRUNCATE, 1)))
    whole, cut, after = read(grabber, 3)
    assert cut.defect == "truncated: 1536 of 3072 bytes"
    assert cut.pixels[:24].any()
    assert not cut.pixels[24:].any()
    assert (whole.defect, after.defect) == (None, None)
    assert grabber.counters.corrupt == 1


def test_frozen_frames_repeat_the_picture_under_new_numbers_unnoticed(make):
    grabber = streaming(make(Fault(FaultKind.FREEZE, 3, frames=3)))
    frames = read(grabber, 8)
    assert [f.sequence for f in frames] == list(range(8))
    assert [grabber.scene_number(f.pixels) for f in frames] == [0, 1, 2, 2, 2, 2, 6, 7]
    assert all(f.defect is None for f in frames)


def test_black_and_noise_pass_unnoticed_by_the_device(make):
    grabber = streaming(make(Fault(FaultKind.BLACK, 1), Fault(FaultKind.NOISE, 2, frames=2)))
    frames = read(grabber, 5)
    assert [f.defect for f in frames] == [None] * 5
    assert [bool(f.pixels.any()) for f in frames] == [True, False, True, True, True]
    assert frames[2].pixels.std() > 60
    assert not np.array_equal(frames[2].pixels, frames[3].pixels)


def test_a_flagged_frame_has_a_defect(make):
    frames = read(streaming(make(Fault(FaultKind.ERROR_FLAG, 1, frames=2))), 4)
    assert [f.defect for f in frames] == [None, *["the device flagged an error"] * 2, None]


def test_a_frame_of_wrong_size_has_a_defect(make):
    frames = read(streaming(make(Fault(FaultKind.WRONG_SIZE, 1))), 3)
    assert [f.size_px for f in frames] == [(64, 48), (32, 24), (64, 48)]
    assert frames[1].defect == "is 32x24 px where 64x48 px were granted"


@pytest.mark.parametrize("speed", [1.0, math.inf])
def test_a_hanging_device_times_out_and_goes_on_by_itself(make, speed):
    grabber = streaming(make(Fault(FaultKind.HANG, 2, seconds=1.0), speed=speed))
    read(grabber, 2)
    for _ in range(9):
        with pytest.raises(DeviceTimeoutError):
            grabber.read(0.1)
    assert grabber.state is GrabberState.STREAMING
    assert [f.sequence for f in read(grabber, 3)] == [2, 3, 4]
    assert grabber.counters.lost == 0
    assert_balanced(grabber)


@pytest.mark.parametrize("speed", [1.0, math.inf])
def test_a_device_that_hangs_for_ever_is_healed_by_a_restart(make, speed):
    grabber = streaming(make(Fault(FaultKind.HANG, 2, seconds=math.inf), speed=speed))
    read(grabber, 2)
    with pytest.raises(DeviceTimeoutError):
        grabber.read(3600.0)
    grabber.stop()
    grabber.start()
    assert [f.sequence for f in read(grabber, 3)] == [0, 1, 2]


@pytest.mark.parametrize("speed", [1.0, math.inf])
def test_an_unplugged_device_is_gone_until_it_is_plugged_in_again(make, speed):
    grabber = streaming(make(Fault(FaultKind.DISCONNECT, 3, seconds=2.0), speed=speed))
    read(grabber, 3)
    with pytest.raises(DeviceDisconnectedError, match="simulated"):
        grabber.read(1.0)
    assert grabber.state is GrabberState.FAULTED
    with pytest.raises(DeviceStateError):
        grabber.read(1.0)
    grabber.close()
    with pytest.raises(DeviceNotFoundError, match="unplugged"):
        grabber.open()
    assert grabber.state is GrabberState.CLOSED
    grabber.clock.advance(2.0)
    streaming(grabber)
    frame = grabber.read(1.0)
    assert (frame.generation, frame.sequence) == (2, 0)
    assert_balanced(grabber)


def test_frames_waiting_when_it_is_unplugged_are_lost_and_counted(make):
    grabber = streaming(make(Fault(FaultKind.DISCONNECT, 3)))
    read(grabber, 1)
    grabber.clock.advance(1.0)
    with pytest.raises(DeviceDisconnectedError):
        grabber.read(1.0)
    assert grabber.record.discarded == 2
    assert_balanced(grabber)
    grabber.close()
    assert streaming(grabber).read(1.0).sequence == 0


def test_a_wrapping_device_number_grows_on_for_the_reader(make):
    grabber = streaming(make(Fault(FaultKind.SEQUENCE_WRAP, 3), Fault(FaultKind.DROP, 5)))
    numbers = [f.sequence for f in read(grabber, 6)]
    assert numbers == [SEQUENCE_NUMBERS + i for i in (-3, -2, -1, 0, 1, 3)]
    assert grabber.counters.lost == 1
    grabber.stop()
    grabber.start()
    assert grabber.read(1.0).sequence == 0


def test_faults_at_the_same_frame_all_happen(make):
    grabber = streaming(
        make(
            Fault(FaultKind.HANG, 1, seconds=0.5),
            Fault(FaultKind.ERROR_FLAG, 1),
            Fault(FaultKind.DISCONNECT, 1),
            Fault(FaultKind.BLACK, 1),
        )
    )
    read(grabber, 1)
    with pytest.raises(DeviceDisconnectedError):
        grabber.read(1.0)
    grabber.close()
    streaming(grabber)
    frame = grabber.read(2.0)
    assert frame.defect == "the device flagged an error"
    assert not frame.pixels.any()
    assert grabber.record.struck == Counter(
        {FaultKind.HANG: 1, FaultKind.ERROR_FLAG: 1, FaultKind.DISCONNECT: 1, FaultKind.BLACK: 1}
    )


@pytest.mark.parametrize("wrong", [{"at": -1}, {"frames": 0}, {"seconds": -1.0}, {"seconds": math.nan}])
def test_an_impossible_fault_is_refused(wrong):
    with pytest.raises(ValueError, match="must be"):
        Fault(FaultKind.DROP, **({"at": 1} | wrong))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("speed", [1.0, math.inf])
@pytest.mark.parametrize("field_mode", [FieldMode.FRAME, FieldMode.ALTERNATE])
def test_under_random_faults_every_frame_is_accounted_for(make, seed, speed, field_mode):
    rng = np.random.default_rng(seed)
    script = random_faults(rng, 2000, 0.05)
    grabber = make(*script, speed=speed, field_mode=field_mode)
    streaming(grabber)
    keys, lost, seen, restarts = set(), 0, Counter(), 0
    while grabber.record.exposed < 2000:
        if rng.random() < 0.02:
            grabber.clock.advance(rng.uniform(0, 0.5))
        try:
            frame = grabber.read(0.05)
        except DeviceTimeoutError:
            seen["timeouts"] += 1
        except DeviceDisconnectedError:
            seen["disconnects"] += 1
            restarts += 1
            lost += grabber.counters.lost
            grabber.close()
            grabber.clock.advance(0.2)
            streaming(grabber)
        else:
            seen["corrupt"] += frame.defect is not None
            keys.add((restarts, frame.sequence))
    lost += grabber.counters.lost
    assert_balanced(grabber)
    record = grabber.record
    assert len(keys) == record.delivered - record.repeated
    # what was lost before the first and after the last frame of a stream shows in no gap
    assert lost <= record.dropped + record.overrun
    begun = Counter(f.kind for f in script)
    assert all(begun[k] - record.struck[k] in (0, 1) for k in FaultKind)
    assert seen["disconnects"] == record.struck[FaultKind.DISCONNECT]
    assert seen["corrupt"] > 0


def test_the_same_seed_gives_the_same_script():
    a, b = (random_faults(np.random.default_rng(7), 500, 0.1) for _ in range(2))
    assert a == b
    assert 25 < len(a) < 80
    only = random_faults(np.random.default_rng(7), 500, 0.1, kinds=[FaultKind.DROP])
    assert {f.kind for f in only} == {FaultKind.DROP}


# -- 32-bit numbers ----------------------------------------------------------------------------------------------------


def test_a_number_is_carried_on_past_its_wrap_over_gaps_and_back():
    extender = SequenceExtender()
    raw = [SEQUENCE_NUMBERS - 2, SEQUENCE_NUMBERS - 1, 3, 2, 4]
    assert [extender.extend(n) - SEQUENCE_NUMBERS for n in raw] == [-2, -1, 3, 2, 4]
    extender.restart()
    assert extender.extend(5) == 5
