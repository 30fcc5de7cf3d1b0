from drivers.frame import Field
from service.acquisition.ledger import Outcome
from service.acquisition.measuring import FrameMeasurer
from tests.fakes.clock import ManualClock
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
