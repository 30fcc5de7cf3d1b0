"""What is said of a session that was measured again."""

import pytest

from service.sinks.session.comparison import Comparison
from service.sinks.session.reader import open_session
from service.vision.measurement import Lock
from tests.sinks.session.recorded import Recording, frame, results


@pytest.fixture(params=["from the start", "midst"])
def session(tmp_path, request):
    """Three frames, recorded from the first one on or in the midst of a watch."""
    at_start = request.param == "from the start"
    with Recording(tmp_path, enabled=at_start) as recording:
        if not at_start:
            recording.recorder.start_recording()
        recording.feed(*(frame(k) for k in range(3)))
    (folder,) = tmp_path.iterdir()
    return open_session(folder)


def compared(session, **measurement):
    comparison = Comparison(session)
    for k in range(3):
        comparison.accept(frame(k), results(frame(k), **measurement))
    return comparison


def test_equal_results_are_the_same_however_recording_began(session):
    comparison = compared(session)
    assert comparison.same
    assert comparison.problem is None
    assert len(comparison.lines()) == 1


def test_other_results_are_named_or_said_to_rest_on_frames_that_are_not_recorded(session):
    comparison = compared(session, lock=Lock.NONE)
    assert not comparison.same
    assert comparison.problem in "\n".join(comparison.lines())
    if session.about.from_start:
        assert "lock was" in comparison.problem
        assert comparison.different == 3
    else:
        assert "record from the start" in comparison.problem
        assert comparison.inexact == 3


def test_that_nothing_was_measured_is_no_agreement(session):
    comparison = Comparison(session)
    assert not comparison.same
    assert comparison.problem == "nothing could be measured again"
