"""Lens and range finder doubt a measurement, never change its figures, and are told when they persist."""

from dataclasses import replace

import pytest

from drivers.reading import Quality
from service.acquisition.cross_check import CrossCheck, doubted, priors_of
from service.acquisition.live import LiveService
from service.acquisition.readings import Calibration, InstrumentReadings
from service.alignment.consistency import Source, Verdict
from service.vision.measurement import Doubt, Lock
from tests.fakes.results import CAMERA, make_measurement
from tests.fakes.scripted import PATIENCE_S, FakeMeasurer, RememberingSink, ScriptedGrabber

AXIAL_MM = 1000.0
AGREEING = InstrumentReadings(
    distance_mm=AXIAL_MM, distance_sigma_mm=3.0, distance_age_s=0.1, distance_quality=Quality.GOOD,
    distance_reason=None, focal_length_mm=CAMERA.focal_length_mm, focal_sigma_mm=0.05, zoom_position=8192,
    focus_position=100, lens_age_s=0.2, focal_quality=Quality.GOOD, focal_reason=None, lens_moving=False,
    calibration=Calibration.CURRENT,
)  # fmt: skip
MOVED = replace(AGREEING, calibration=Calibration.STALE, calibration_reason="zoom stands at 9000, calibrated at 8192")
SHORT_OF_BOTH = replace(AGREEING, distance_mm=1200.0, focal_length_mm=12.0)
"""Lens and range finder agree on a distance that the lattice's is not."""


def measured(**kwargs):
    return make_measurement(tilt_deg=0.0, **kwargs)


def test_instruments_that_agree_doubt_nothing_and_are_in_the_result():
    m, priors = CrossCheck(lambda: AGREEING).apply(measured())
    assert m.lock is Lock.FULL
    said = priors.to_dict()
    assert said["distance"] == {"value_mm": 1000.0, "sigma_mm": 3.0, "age_s": 0.1, "reason": None}
    assert said["focal_length"]["value_mm"] == 10.0
    assert (said["verdict"], said["odd_one_out"], said["calibration"]) == ("agreement", None, "current")


def test_a_lens_that_moved_off_takes_the_calibration_with_it():
    m = doubted(measured(), priors_of(MOVED, measured()))
    assert (m.lock, m.doubt) == (Lock.PARTIAL, (Doubt.CALIBRATION,))


def test_a_lattice_that_is_the_odd_one_out_has_its_scale_in_doubt():
    m, priors = CrossCheck(lambda: SHORT_OF_BOTH).apply(measured())
    assert priors.consistency.odd is Source.LATTICE
    assert Doubt.SCALE in m.doubt
    assert m.pose.distance_mm == AXIAL_MM


@pytest.mark.parametrize(
    ("readings", "odd"),
    [
        (replace(AGREEING, distance_mm=1200.0), Source.RANGE_FINDER),
        (replace(AGREEING, focal_length_mm=12.0), Source.LENS),
    ],
)
def test_an_instrument_that_is_the_odd_one_out_is_named_and_doubts_nothing(readings, odd):
    m, priors = CrossCheck(lambda: readings).apply(measured())
    assert priors.consistency.odd is odd
    assert m.lock is Lock.FULL


def test_doubts_are_added_to_those_of_the_picture():
    m = doubted(measured(lock=Lock.PARTIAL, doubt=(Doubt.FOCUS,)), priors_of(MOVED, measured()))
    assert set(m.doubt) == {Doubt.FOCUS, Doubt.CALIBRATION}


def test_without_a_lock_there_is_nothing_to_doubt():
    m, priors = CrossCheck(lambda: MOVED).apply(make_measurement(Lock.NONE))
    assert (m.lock, m.doubt) == (Lock.NONE, ())
    assert priors.consistency.verdict is Verdict.CANNOT_TELL


def test_what_persists_is_told_once_and_its_end_too():
    said, readings = [], [AGREEING]
    check = CrossCheck(lambda: readings[0], lambda *event: said.append(event))

    def pictures(what, first_s, last_s):
        readings[0] = what
        for tenth in range(first_s * 10, last_s * 10):
            check.apply(replace(measured(), time_ns=tenth * 100_000_000))

    pictures(AGREEING, 0, 2)
    pictures(SHORT_OF_BOTH, 2, 5)
    pictures(AGREEING, 5, 8)
    pictures(MOVED, 8, 10)
    pictures(AGREEING, 10, 12)
    assert [level for _, level in said] == ["WARN", "INFO", "WARN", "INFO"]
    assert "lattice is the odd one out" in said[0][0]
    assert said[2][0] == "the camera's calibration is stale: zoom stands at 9000, calibrated at 8192"
    assert said[3][0] == "the camera's calibration is current"


def test_a_single_picture_s_disagreement_is_not_told():
    said, readings = [], [AGREEING]
    check = CrossCheck(lambda: readings[0], lambda *event: said.append(event))
    for tenth in range(40):
        readings[0] = SHORT_OF_BOTH if tenth % 3 == 0 else AGREEING
        check.apply(replace(measured(), time_ns=tenth * 100_000_000))
    assert said == []


def test_the_live_service_puts_them_into_every_result():
    sink = RememberingSink()
    measurer = FakeMeasurer(lambda: [measured()])
    service = LiveService(
        ScriptedGrabber([0, 1]), lambda _: measurer, [sink], every_frame=True, check=CrossCheck(lambda: MOVED)
    )
    with service:
        service.start()
        assert service.wait(PATIENCE_S)
    results = [result for _, (result,) in sink.got]
    assert [r.measurement.doubt for r in results] == [(Doubt.CALIBRATION,)] * 2
    assert results[0].to_dict()["instruments"]["calibration"] == "stale"
    assert "instruments" not in replace(results[0], instruments=None).to_dict()
