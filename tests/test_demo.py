import itertools

import av
import numpy as np
import pytest

from service.config.cameras import read_camera
from service.config.generators import load_generator
from service.demo import DEMO_GENERATOR, demo_camera, demo_video


@pytest.fixture(scope="module")
def pictures():
    with av.open(str(demo_video())) as video:
        return [(f.pts * f.time_base, f.color_range, f.to_ndarray(format="gray")) for f in video.decode(video=0)]


def test_the_demonstration_is_small_enough_to_ship():
    assert demo_video().stat().st_size <= 12_000_000


def test_its_frames_come_every_40_ms_in_full_range(pictures):
    times = [float(time) for time, _, _ in pictures]
    assert {round(b - a, 6) for a, b in itertools.pairwise(times)} == {0.04}
    assert {color_range for _, color_range, _ in pictures} == {2}
    assert min(p.min() for _, _, p in pictures) < 8
    assert max(p.max() for _, _, p in pictures) > 245


def test_it_goes_there_and_back_so_that_it_loops(pictures):
    p = [picture.astype(float) for _, _, picture in pictures]
    n = len(p)
    middle = n // 2
    step = np.abs(p[1] - p[0]).mean()
    assert np.abs(p[n - 1] - p[1]).mean() < step  # the last frame is the second one again: the first comes next
    assert np.abs(p[middle + 5] - p[middle - 5]).mean() < step
    assert np.abs(p[middle] - p[0]).mean() > step


def test_its_camera_is_known_and_of_its_size(pictures):
    camera = read_camera(demo_camera())
    assert camera.complete
    assert camera.image_size_px == pictures[0][2].shape[::-1]
    assert load_generator(DEMO_GENERATOR).lattice.arrangement == "square"
