"""What came back through the device is measured here: in the guest the kernels would be compiled by an emulation."""

import math
import time

import numpy as np

from drivers.replay import ReplayGrabber
from service.config.cameras import read_camera
from service.config.generators import load_generator
from service.demo import DEMO_GENERATOR, demo_camera, demo_video
from service.vision.measurement import Lock
from service.vision.process import Measurer

PERIOD_NS = 40_000_000


def poses(pictures) -> list:
    measurer = Measurer(read_camera(demo_camera()), load_generator(DEMO_GENERATOR).lattice, time.perf_counter_ns)
    found = [measurer.measure(p, i * PERIOD_NS, "progressive")[0] for i, p in enumerate(pictures)]
    assert all(m.lock is not Lock.NONE for m in found)
    return [(m.pose.rotation.tolist(), m.pose.translation_mm.tolist(), m.tubes.center_px.tolist()) for m in found]


def test_the_pose_measured_from_the_device_is_that_of_the_replay_to_the_last_bit(exchange):
    caught = np.load(exchange / "caught.npy")
    assert len(caught) >= 10
    with ReplayGrabber(demo_video(), speed=math.inf) as replay:
        replay.start()
        recorded = [replay.read(1.0).pixels for _ in caught]
    assert poses(caught) == poses(recorded)
