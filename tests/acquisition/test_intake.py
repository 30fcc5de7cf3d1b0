"""Frames of whatever grabber and stream are numbered through, counted once and handed on."""

import numpy as np

from service.acquisition.content import PictureWatch
from service.acquisition.intake import Intake
from service.acquisition.ledger import Ledger
from service.acquisition.slot import FrameQueue
from tests.fakes.clock import ManualClock
from tests.fakes.scripted import make_frame


def made(watch=None):
    queue, ledger = FrameQueue(100), Ledger()
    return Intake(queue, ledger, [], ManualClock(), watch), queue, ledger


def generations(queue):
    return [queue.take(0).generation for _ in range(queue.depth)]


def test_each_stream_is_a_generation_though_its_grabber_was_opened_once():
    intake, queue, ledger = made()
    for _ in range(3):
        intake.begin_stream(1)
        for i in range(2):
            intake.take(make_frame(i, generation=1))
    assert generations(queue) == [1, 1, 2, 2, 3, 3]
    assert intake.generation == 3
    assert (ledger.account().span, ledger.account().unnumbered) == (6, 0)


def test_another_grabber_goes_on_where_the_one_before_stood():
    intake, queue, _ = made()
    intake.begin_stream(4)
    intake.take(make_frame(0, generation=4))
    intake.begin_stream(1)
    intake.take(make_frame(0, generation=1))
    assert generations(queue) == [4, 5]


def test_another_view_is_a_generation_whose_numbers_go_on():
    intake, queue, ledger = made()
    intake.begin_stream(1)
    intake.take(make_frame(0))
    intake.begin_view()
    intake.take(make_frame(3))
    assert generations(queue) == [1, 2]
    assert ledger.account().lost == 2


def test_a_recording_s_own_generations_stay_and_begin_new_counts():
    intake, queue, ledger = made()
    intake.begin_stream(1)
    for generation, number in [(3, 7), (3, 8), (4, 0), (4, 1)]:
        intake.take(make_frame(number, generation=generation))
    assert generations(queue) == [3, 3, 4, 4]
    assert ledger.account().span == 4
    assert intake.generation == 4


def test_a_new_stream_forgets_what_the_one_before_showed():
    watch = PictureWatch(3, 4)
    intake, queue, _ = made(watch)
    still = np.random.default_rng(0).integers(0, 255, (48, 64), np.uint8)
    for _ in range(2):
        intake.begin_stream(1)
        for i in range(2):
            frame = make_frame(i)
            intake.take(type(frame)(still, *[getattr(frame, n) for n in list(frame.__slots__)[1:]]))
    assert [queue.take(0).defect for _ in range(4)] == [None] * 4


def test_an_arrival_says_when_and_whether_it_was_good():
    intake, _, _ = made()
    intake.begin_stream(1)
    assert not intake.last.started
    assert intake.silent_s(0) is None
    intake.take(make_frame(0, defect="torn"))
    assert intake.last.started
    assert intake.last.bad
    assert intake.silent_s(intake.last.time_ns + 2_000_000_000) == 2.0
