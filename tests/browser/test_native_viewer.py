"""The viewer as it looks: skipped where no Vulkan driver can draw it."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from service.sinks.viewer_drawing import Watch
from service.sinks.viewer_file import ViewerFileSink
from service.sinks.viewer_marks import COLORS, LOCK_COLORS
from service.vision.measurement import Doubt, Lock
from tests.browser.make_screenshot import take_screenshot
from tests.fakes.drawn import LATTICE, made_up

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not any(Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")),
        reason="no Vulkan that draws in software (mesa-vulkan-drivers)",
    ),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # rerun's own screenshot client is experimental
]


def screenshot(tmp_path, **last):
    sink = ViewerFileSink(tmp_path / "x.rrd", Watch(LATTICE, title="REPLAY of a test"))
    sink.start()
    for i in range(6):
        frame, result = made_up(i, size=(640, 480), **(last if i == 5 else {}))
        sink.accept(frame, (result,))
    sink.close(30.0)
    take_screenshot(tmp_path / "x.rrd", tmp_path / "x.png", "1280x800")
    picture = cv2.imread(str(tmp_path / "x.png"))
    assert picture.shape[1] == 1280
    return picture[..., ::-1].astype(int)


def share(picture, color):
    """Pixels of about that colour."""
    return np.count_nonzero(np.abs(picture - np.array(color[:3])).max(axis=2) < 12)


def test_the_operators_layout_shows_tubes_of_each_kind(tmp_path):
    picture = screenshot(tmp_path)
    left, right = picture[:, :780], picture[:, 820:]
    assert share(left, (90, 90, 90)) > 50_000  # the picture, large at the left
    for color in COLORS[:3]:
        assert share(left, color) > 20, color
    assert share(right, (38, 40, 43)) > 5_000  # the sheet's view at the right
    assert share(left, LOCK_COLORS[Lock.NONE]) == 0


@pytest.mark.parametrize(("lock", "more"), [(Lock.NONE, {}), (Lock.PARTIAL, {"doubt": (Doubt.LIGHT,)})])
def test_a_lock_that_is_not_full_frames_the_picture(tmp_path, lock, more):
    picture = screenshot(tmp_path, lock=lock, **more)
    assert share(picture[:, :780], LOCK_COLORS[lock]) > 2_000
