"""What measuring remembers, kept and made anew to the last bit; and what is not is refused."""

import collections
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ConfigError
from drivers.frame import Field
from service.sinks.session.memory import Memory
from service.vision.camera import Camera, TsaiLens
from service.vision.fields import Interlace, Scan
from service.vision.measurement import Doubt


def kept(value):
    return Memory.from_bytes(Memory.of({"value": value}).to_bytes()).values()["value"]


@given(st.floats())
def test_floats_are_kept_to_the_last_bit(value):
    assert math.copysign(1, kept(value)) == math.copysign(1, value) or math.isnan(value)
    assert kept(value) == value or math.isnan(value)
    assert type(kept(np.float64(value))) is np.float64


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        -3,
        2**70,
        "ä",
        (1, (2.5, None)),
        [1, [2]],
        {"a": 1, (1, 2): [3]},
        Doubt.INDEX,
        {Field.TOP: (64, 48)},
        (),
    ],
)
def test_what_is_made_of_plain_values_is_the_same(value):
    made = kept(value)
    assert made == value
    assert type(made) is type(value)


def test_a_deque_keeps_its_bound():
    made = kept(collections.deque([1, 2], maxlen=3))
    assert (list(made), made.maxlen) == ([1, 2], 3)


@pytest.mark.parametrize("writeable", [True, False])
@pytest.mark.parametrize("dtype", [np.float64, np.uint8, bool, np.int32])
def test_arrays_keep_values_kind_layout_and_whether_they_may_be_written(dtype, writeable):
    base = np.random.default_rng(0).integers(0, 2, (5, 7, 3)).astype(dtype)
    for seen in (base, base.T, base[:, 1:4], base[0, 0], base[:0], np.array(base[0, 0, 0])):
        value = seen.view()
        value.flags.writeable = writeable
        made = kept(value)
        assert np.array_equal(made, value)
        assert made.dtype == value.dtype
        for flag in ("C_CONTIGUOUS", "F_CONTIGUOUS", "WRITEABLE"):
            assert made.flags[flag] == value.flags[flag]


def test_objects_of_measuring_are_made_anew():
    camera = kept(Camera((640, 480), (0.005, 0.005), 10.0, TsaiLens(0.001), (320.0, 240.0)))
    assert (camera.lens, camera.focal_length_mm, camera.image_size_px) == (TsaiLens(0.001), 10.0, (640, 480))
    interlace = Interlace()
    interlace.scan = Scan.INTERLACED
    assert vars(kept(interlace)) == vars(interlace)


def test_later_changes_do_not_reach_what_was_kept():
    array = np.zeros(3)
    memory = Memory.of({"value": [array]})
    array += 1.0
    assert memory.values()["value"][0].tolist() == [0.0] * 3


@pytest.mark.parametrize("value", [print, object(), lambda: 0, np.array([None]), {1, 2}, b"x", json.JSONDecoder()])
def test_what_is_of_another_kind_is_refused(value):
    with pytest.raises(TypeError):
        Memory.of({"value": value})


@pytest.mark.parametrize(
    "made",
    [
        {"object": ["subprocess:Popen", {}]},
        {"object": ["service.vision.process:warm_up", {}]},
        {"object": ["service.vision.process:np", {}]},
        {"object": ["service.vision.camera:TsaiLens", {"other": 1}]},
        {"object": ["service.vision.nothing:TsaiLens", {}]},
        {"enum": ["service.vision.measurement:Doubt", "no such"]},
        {"array": [7, "C", True]},
        {"eval": "1"},
    ],
)
def test_what_a_file_should_not_have_is_not_made(made):
    tree = json.dumps({"version": 2, "values": {"dict": [["value", made]]}})
    with pytest.raises(ConfigError, match="cannot be read"):
        Memory(tree, ()).values()


def test_a_file_that_is_none_or_of_a_later_version_is_refused():
    whole = Memory.of({"value": np.zeros(1000)}).to_bytes()
    for data in (b"", b"PK", whole[:100]):
        with pytest.raises(ConfigError):
            Memory.from_bytes(data)
    with pytest.raises(ConfigError, match="version 3"):
        Memory('{"version": 3, "values": {}}', ()).values()
    with pytest.raises(ConfigError):
        Memory.none().values()
