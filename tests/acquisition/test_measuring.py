import pytest

from drivers.errors import ConfigError
from drivers.frame import Field
from service.acquisition.ledger import Outcome
from service.acquisition.measuring import FrameMeasurer
from tests.fakes.clock import ManualClock
from tests.fakes.results import make_measurement
from tests.fakes.scripted import FakeMeasurer, make_frame, nothing_found


def test_a_result_carries_its_frames_identity():
    (result,), outcome = FrameMeasurer(FakeMeasurer(), None, ManualClock()).answer(make_frame(7, generation=3))
    assert (result.source, result.sequence, result.timestamp_ns, result.generation) == ("fake", 7, 280_000_000, 3)
    assert outcome is Outcome.PROCESSED


def test_an_interlaced_frame_has_two_answers_of_one_number():
    measurer = FakeMeasurer(lambda: [nothing_found("top"), nothing_found("bottom")])
    results, _ = FrameMeasurer(measurer, None, ManualClock()).answer(make_frame(7))
    assert [(r.sequence, r.measurement.field) for r in results] == [(7, "top"), (7, "bottom")]


def test_frames_without_a_number_are_counted_here():
    frames = FrameMeasurer(FakeMeasurer(), None, ManualClock())
    assert [frames.answer(make_frame(None))[0][0].sequence for _ in range(3)] == [0, 1, 2]


def test_a_reopened_source_starts_from_nothing():
    measurer = FakeMeasurer()
    frames = FrameMeasurer(measurer, None, ManualClock())
    for generation in (1, 1, 2, 2):
        frames.answer(make_frame(0, generation=generation))
    assert measurer.resets == 2


def test_the_field_order_asked_for_overrules_the_source_but_for_single_fields():
    measurer = FakeMeasurer()
    FrameMeasurer(measurer, None, ManualClock()).answer(make_frame(0, field=Field.UNKNOWN))
    ordered = FrameMeasurer(measurer, Field.INTERLACED_TOP_FIRST, ManualClock())
    for field in (Field.UNKNOWN, Field.PROGRESSIVE, Field.BOTTOM):
        ordered.answer(make_frame(0, field=field))
    fields = [field for _, _, field in measurer.calls]
    assert fields == ["unknown", "interlaced-top-first", "interlaced-top-first", "bottom"]


def test_a_bad_field_is_answered_as_that_field():
    (result,), _ = FrameMeasurer(FakeMeasurer(), None, ManualClock()).answer(
        make_frame(0, field=Field.BOTTOM, defect="torn")
    )
    assert result.measurement.field == "bottom"


class ScriptedInterpreter:
    """Notes what it is given; names every tube, or raises."""

    def __init__(self, error=None):
        self.error, self.seen, self.chosen = error, [], {}

    def settle_index(self, settler):
        pass

    def read(self, measurement, generation, *, fresh=True):
        self.seen.append((measurement.field, generation, fresh))
        if self.error:
            raise self.error
        return ["L1R1"] * len(measurement.tubes), None


def test_every_answer_is_interpreted_with_its_generation():
    interpreter = ScriptedInterpreter()
    measurer = FakeMeasurer(lambda: [make_measurement(field="top"), nothing_found("bottom")])
    results, _ = FrameMeasurer(measurer, None, ManualClock(), interpreter).answer(make_frame(7, generation=3))
    assert [len(r.names) for r in results] == [5, 0]
    assert [tube["name"] for tube in results[0].to_dict()["tubes"]] == ["L1R1"] * 5
    assert interpreter.seen == [("top", 3, True), ("bottom", 3, True)]


def test_a_picture_that_is_the_same_as_the_last_is_not_fresh():
    interpreter = ScriptedInterpreter()
    frames = FrameMeasurer(FakeMeasurer(), None, ManualClock(), interpreter)
    for k in range(3):
        frames.answer(make_frame(k))
    frames.answer(make_frame(3, size=(32, 24)))
    assert [fresh for *_, fresh in interpreter.seen] == [True, False, False, True]


def test_a_mistake_in_judging_leaves_the_measurement_and_is_counted(caplog):
    interpreter = ScriptedInterpreter(ValueError("oh"))
    measurer = FakeMeasurer(lambda: [make_measurement()])
    (result,), outcome = FrameMeasurer(measurer, None, ManualClock(), interpreter).answer(make_frame(0))
    assert (result.measurement.lock, list(result.names), result.alignment) == ("full", [], None)
    assert outcome is Outcome.FAILED
    assert "could not be judged: ValueError: oh" in caplog.text


def test_frames_of_another_size_are_measured_anew_or_it_is_said_why_not():
    made = []

    def remake(frame):
        if frame.size_px[0] > 100:
            raise ConfigError(f"fake: its pictures are {frame.size_px[0]} px wide, but camera 'mine' has 64")
        made.append(frame.size_px)
        return FakeMeasurer()

    frames = FrameMeasurer(FakeMeasurer(), None, ManualClock(), remake=remake)
    sizes = [(64, 48), (64, 48), (32, 24), (720, 576), (720, 576), (64, 48)]
    reasons = [frames.answer(make_frame(i, size=size))[0][0].measurement.reason for i, size in enumerate(sizes)]
    assert made == [(32, 24), (64, 48)]
    assert reasons[3] == reasons[4] == "fake: its pictures are 720 px wide, but camera 'mine' has 64"
    assert reasons[5] == "nothing there"


def test_bad_frames_of_another_size_change_nothing():
    frames = FrameMeasurer(FakeMeasurer(), None, ManualClock(), remake=lambda _: pytest.fail("made anew"))
    for i in range(6):
        frames.answer(make_frame(i, size=(32, 24), defect="half the size") if i % 2 else make_frame(i))
