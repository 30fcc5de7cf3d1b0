import math
import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.errors import ConfigError
from drivers.frame import Field
from service.sinks.base import SinkStats, SourceState
from service.sinks.viewer_drawing import Watch
from service.sinks.viewer_file import ViewerFileSink
from service.vision.measurement import Doubt, Lock, Tubes
from tests.fakes.drawn import LATTICE, frame_of, made_up, result_of
from tests.fakes.rrd import Rrd

LONG_S = 30.0


def saved(path, frames, **watch):
    sink = ViewerFileSink(path, Watch(LATTICE, **watch))
    sink.start()
    for frame, *results in frames:
        sink.accept(frame, tuple(results))
    sink.close(LONG_S)
    assert sink.stats() == SinkStats(accepted=len(frames))
    return Rrd(path)


def picture_of(rrd, row):
    (blob,) = rrd.column("/picture", "EncodedImage:blob")[row]
    return cv2.imdecode(np.frombuffer(bytes(blob), np.uint8), cv2.IMREAD_UNCHANGED)


def test_every_frame_is_there_with_its_own_results(tmp_path):
    rrd = saved(tmp_path / "x.rrd", [made_up(i) for i in range(30)])
    for entity in ("/picture", "/picture/tubes", "/trend/distance", "/trend/tilt", "/status"):
        assert rrd.frames(entity) == list(range(30)), entity
    for entity in ("/sheet/tubes", "/sheet/camera", "/sheet/camera/lens", "/sheet/view"):
        assert rrd.frames(entity) == list(range(0, 30, 3)), entity  # eight times a second
    assert rrd.column("/trend/distance", "Scalars:scalars")[7] == pytest.approx([400.7, 400.45, 400.95])
    assert rrd.column("/trend/tilt", "Scalars:scalars")[7] == pytest.approx([0, -0.08, 0.08])
    assert rrd.column("/picture", "time")[:3] == [0, 40_000_000, 80_000_000]


def test_tubes_of_each_kind_have_their_own_shape_and_class(tmp_path):
    rrd = saved(tmp_path / "x.rrd", [made_up()])
    (strips,) = rrd.column("/picture/tubes", "LineStrips2D:strips")
    (ids,) = rrd.column("/picture/tubes", "LineStrips2D:class_ids")
    assert ids == [0, 0, 0, 0, 1, 1, 2, 3]  # measured, predicted, plugged, absent
    ring, cross, crossed, dot = (np.array(strips[i]) for i in (0, 4, 6, 7))
    middle = (79.5, 59.5)
    pitch_px = 24.892 * 2.0 / 0.0056 / 400
    radius_px = 7.7216 * 2.0 / 0.0056 / 400
    centers = np.array(middle) + 0.5 + pitch_px * np.array([[-1, -1], [0, 1], [0, 1], [1, 1]])
    np.testing.assert_allclose(np.linalg.norm(ring - centers[0], axis=1), radius_px, rtol=1e-3)
    np.testing.assert_allclose(ring[0], ring[-1])
    np.testing.assert_allclose(np.ptp(cross, axis=0), [radius_px, radius_px], rtol=0.05)
    np.testing.assert_allclose(np.linalg.norm(crossed - centers[2], axis=1), radius_px, rtol=1e-3)
    across = np.linalg.norm(np.diff(crossed, axis=0), axis=1)
    assert np.count_nonzero(np.isclose(across, 2 * radius_px, rtol=1e-3)) == 2  # its two diagonals
    np.testing.assert_allclose(dot.mean(axis=0), centers[3], atol=1e-3)


def test_the_camera_stands_where_the_pose_says(tmp_path):
    rrd = saved(tmp_path / "x.rrd", [made_up()])
    assert rrd.column("/sheet/camera", "Transform3D:translation") == [[pytest.approx([0, 0, -400])]]
    (matrix,) = rrd.column("/sheet/camera/lens", "Pinhole:image_from_camera")
    assert matrix[0] == pytest.approx([2 / 0.0056, 0, 0, 0, 2 / 0.0056, 0, 80, 60, 1])
    border, axis = (np.array(s) for s in rrd.column("/sheet/view", "LineStrips3D:strips")[0])
    np.testing.assert_allclose(np.ptp(border, axis=0), [160 * 0.0056 * 200, 120 * 0.0056 * 200, 0], atol=1e-3)
    np.testing.assert_allclose(axis, [[0, 0, -400], [0, 0, 0]], atol=1e-4)


def test_a_lost_lock_says_why_and_leaves_gaps_and_no_camera(tmp_path):
    frames = [made_up(0), made_up(1, lock=Lock.NONE, reason="lamp off"), made_up(2)]
    rrd = saved(tmp_path / "x.rrd", frames)
    assert all(math.isnan(v) for v in rrd.column("/trend/tilt", "Scalars:scalars")[1])
    assert rrd.column("/sheet/camera", "Transform3D:translation")[1] is None
    assert rrd.column("/sheet/camera", "Clear:is_recursive")[1] == [True]
    assert rrd.column("/picture/tubes", "LineStrips2D:strips")[1] == []
    assert rrd.column("/picture/lock/why", "Points2D:labels") == [["lock none: lamp off"]]
    assert rrd.frames("/picture/lock") == [0, 1, 2]  # nothing, the border, nothing again
    assert rrd.column("/state/lock", "StateChange:state") == [["full"], ["none"], ["full"]]
    assert rrd.column("/events", "TextLog:text") == [
        ["0.00 s  lock full"], ["0.04 s  lock none: lamp off"], ["0.08 s  lock full"],
    ]  # fmt: skip
    assert "# Lock none: lamp off" in rrd.column("/status", "TextDocument:text")[1][0]


def test_a_doubt_dims_the_tubes_and_borders_the_picture(tmp_path):
    rrd = saved(tmp_path / "x.rrd", [made_up(lock=Lock.PARTIAL, doubt=(Doubt.LIGHT, Doubt.FOCUS))])
    assert rrd.column("/picture/tubes", "LineStrips2D:class_ids") == [[10, 10, 10, 10, 11, 11, 12, 13]]
    assert rrd.column("/picture/lock/why", "Points2D:labels") == [["lock partial: light, focus in doubt"]]
    assert rrd.column("/picture/lock", "Boxes2D:half_sizes") == [[pytest.approx([80, 60])]]


def test_events_stand_among_the_frames(tmp_path):
    sink = ViewerFileSink(tmp_path / "x.rrd", Watch(LATTICE))
    sink.start()
    sink.event("before all", "WARN")
    sink.accept(made_up(0)[0], (made_up(0)[1],))
    sink.close(LONG_S)
    rrd = Rrd(tmp_path / "x.rrd")
    assert rrd.column("/events", "TextLog:text") == [["0.00 s  before all"], ["0.00 s  lock full"]]
    assert rrd.column("/events", "TextLog:level") == [["WARN"], ["INFO"]]
    assert rrd.column("/events", "time") == [0, 0]


def test_live_times_are_utc(tmp_path):
    rrd = saved(tmp_path / "x.rrd", [made_up(50)], epoch_ns=1_700_000_000_000_000_000)
    assert rrd.column("/picture", "time") == [1_700_000_002_000_000_000]
    assert rrd.column("/events", "TextLog:text") == [["22:13:22.00 UTC  lock full"]]


def test_a_live_event_has_the_present_time_whatever_became_of_the_frames(tmp_path):
    sink = ViewerFileSink(tmp_path / "x.rrd", Watch(LATTICE, epoch_ns=1_700_000_000_000_000_000))
    sink._drawing._monotonic_ns = lambda: 5_000_000_000
    sink.start()
    sink.event("source lost", "ERROR")
    sink.close(LONG_S)
    rrd = Rrd(tmp_path / "x.rrd")
    assert rrd.column("/events", "time") == [1_700_000_005_000_000_000]
    assert rrd.column("/events", "TextLog:text") == [["22:13:25.00 UTC  source lost"]]


def test_frame_numbers_go_on_when_the_source_was_reopened(tmp_path):
    frames = [made_up(5), made_up(6), made_up(0, generation=2), made_up(2, generation=2)]
    assert saved(tmp_path / "x.rrd", frames).frames() == [5, 6, 7, 9]


@pytest.mark.parametrize(("field", "parity"), [("top", 0), ("bottom", 1)])
def test_of_interlaced_video_one_field_is_shown_and_both_are_plotted(tmp_path, field, parity):
    pixels = np.zeros((48, 64), np.uint8)
    pixels[parity::2] = np.linspace(40, 200, 24)[:, None]
    pixels[1 - parity :: 2] = 255  # the other field: not to be seen
    frame = frame_of(pixels, 0)
    other = "bottom" if field == "top" else "top"
    results = [made_up(field=f)[1] for f in (field, other)]
    late = result_of(
        frame, Lock.FULL, results[1].measurement.tubes, results[1].measurement.pose, field=other, time_ns=9
    )
    rrd = saved(tmp_path / "x.rrd", [(frame, results[0], late)])
    picture = picture_of(rrd, 0).astype(int)
    assert picture.shape == (48, 64)
    assert picture.max() < 215
    assert np.all(np.diff(picture[:, 30]) >= -3)  # grows line by line, those between the field's among them
    assert len(rrd.rows["/trend/tilt"]) == 2
    assert len(rrd.rows["/picture"]) == 1


def test_a_field_on_its_own_fills_the_picture(tmp_path):
    pixels = np.full((24, 64), 100, np.uint8)
    frame, result = frame_of(pixels, 0, field=Field.TOP), made_up(field="top")[1]
    assert picture_of(saved(tmp_path / "x.rrd", [(frame, result)]), 0).shape == (48, 64)


@pytest.mark.parametrize(("top", "grey"), [(1023, 255), (4095, 255), (65535, 255), (200, 200)])
def test_deep_pictures_are_shown_by_the_bits_they_use(tmp_path, top, grey):
    pixels = np.full((48, 64), top, np.uint16)
    result = made_up()[1]
    picture = picture_of(saved(tmp_path / "x.rrd", [(frame_of(pixels, 0), result)]), 0)
    assert abs(int(picture.mean()) - grey) <= 1


def test_a_picture_without_tubes_or_with_a_defect_is_shown_all_the_same(tmp_path):
    frame, result = made_up(lock=Lock.NONE, reason="bad frame: truncated")
    empty = result_of(frame, Lock.FULL, Tubes.none(), made_up()[1].measurement.pose)
    rrd = saved(tmp_path / "x.rrd", [(frame, result), (made_up(1)[0], empty)])
    assert len(rrd.rows["/picture"]) == 2


@pytest.mark.parametrize(("name", "word"), [("none/x.rrd", "No such file"), (".", "directory")])
def test_a_file_that_cannot_be_written_is_one_line_at_the_start(tmp_path, name, word):
    sink = ViewerFileSink(tmp_path / name, Watch(LATTICE))
    with pytest.raises(ConfigError, match=word) as error:
        sink.start()
    assert str(tmp_path / name) in str(error.value)
    assert "\n" not in str(error.value)
    sink.close(LONG_S)


def test_a_full_device_is_one_line_at_the_start():
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full here")
    with pytest.raises(ConfigError, match=r"/dev/full: cannot be written: .*No space"):
        ViewerFileSink(full, Watch(LATTICE)).start()


FILLS_UP = """
import logging, resource, sys, time
from pathlib import Path
from service.sinks.viewer_drawing import Watch
from service.sinks.viewer_file import ViewerFileSink
from tests.fakes.drawn import LATTICE, made_up
logging.basicConfig(format="%(message)s")
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
import service.sinks.viewer_file as module
module.CHECK_TIMEOUT_S = 0.2
sink = ViewerFileSink(Path(sys.argv[1]), Watch(LATTICE))
sink.start()
for i in range(400):
    frame, result = made_up(i, size=(640, 480))
    sink.accept(frame, (result,))
    time.sleep(0.002)
deadline = time.monotonic() + 60
while sink.failure is None and time.monotonic() < deadline:
    time.sleep(0.01)
sink.close(2.0)
print(sink.failure, sink.stats(), sep="|")
"""


def test_a_disk_that_fills_up_is_told_and_counted_and_does_not_hold_up_the_end(tmp_path):
    path = tmp_path / "x.rrd"
    run = subprocess.run(
        [sys.executable, "-c", FILLS_UP, path], capture_output=True, text=True, timeout=600, check=False,
        cwd=Path(__file__).parents[2], env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    failure, stats = run.stdout.strip().split("|")
    assert failure.startswith(f"{path} takes no more data")
    counts = eval(stats, {"SinkStats": SinkStats})
    assert counts.accepted == 400
    assert counts.failed > 0
    assert counts.depth == 0
    assert failure in run.stderr
    assert run.stderr.count("takes no more data") == 1
    assert 0 < path.stat().st_size <= 150_000


def test_what_the_picture_is_worth_is_told_with_and_without_frames(tmp_path):
    sink = ViewerFileSink(tmp_path / "x.rrd", Watch(LATTICE))
    sink.start()
    sink.state(SourceState("STARTING", figures="nothing yet"))
    until_taken(sink)
    frame, result = made_up(0)
    sink.accept(frame, (result,))
    for state in (
        SourceState("LIVE", good=True, figures="25 fps"),
        SourceState("NO SIGNAL", "the input has no signal"),
    ):
        sink.state(state)
        until_taken(sink)
    sink.close(LONG_S)
    rrd = Rrd(tmp_path / "x.rrd")
    assert rrd.column("/state/source", "StateChange:state") == [["STARTING"], ["LIVE"], ["NO SIGNAL"]]
    assert rrd.column("/picture/source/why", "Points2D:labels")[-1] == ["NO SIGNAL: the input has no signal"]
    assert rrd.column("/health", "TextDocument:text")[1] == ["25 fps"]


def until_taken(sink):
    deadline = time.monotonic() + LONG_S
    while sink._state is not None:
        assert time.monotonic() < deadline
        time.sleep(0.001)
