"""Descriptors are read as far as they make sense, and nothing in them makes reading fail."""

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.uvc.descriptors import TransferKind, video_functions
from drivers.uvc.inputs import list_inputs
from tests.fakes.uvc import FakeUvcDevice, descriptor

WHOLE = FakeUvcDevice(encodings=("YUYV", "MJPG", "H264"), interlace=5).configuration_descriptor()


def test_what_a_grabber_offers_is_read():
    ((function,)) = video_functions(WHOLE)
    assert (function.control_interface, function.version, function.clock_hz) == (0, 0x0110, 48_000_000)
    assert (function.selector, function.pins) == (5, (1, 2, 3, 4))
    assert [i.name for i in list_inputs(function)] == [f"Composite {n}" for n in (1, 2, 3, 4)]
    ((stream,)) = function.streams
    assert [(f.index, f.encoding, f.code) for f in stream.formats] == [
        (1, "YUYV", "YUY2"), (2, "MJPG", "MJPG"), (3, None, "H264 (frame-based)"),
    ]  # fmt: skip
    first = stream.formats[0]
    assert (first.interlaced, first.top_first, first.default_size) == (True, True, 1)
    assert [(s.index, s.width_px, s.height_px) for s in first.sizes] == [(1, 64, 48), (2, 32, 24)]
    assert first.sizes[0].intervals == (400_000, 800_000)
    assert (stream.bulk.endpoint, stream.bulk.packet_bytes, stream.bulk.number) == (0x81, 512, 0)


def test_an_isochronous_stream_has_no_bulk_setting():
    ((function,)) = video_functions(FakeUvcDevice(bulk=False).configuration_descriptor())
    ((stream,)) = function.streams
    assert stream.bulk is None
    assert [a.kind for a in stream.alternates] == [TransferKind.ISOCHRONOUS]


def test_a_bulk_setting_behind_isochronous_ones_is_found():
    both = FakeUvcDevice(bulk=False).configuration_descriptor() + descriptor(4, 1, 7, 1, 0x0E, 2, 0, 0)
    ((function,)) = video_functions(both + descriptor(5, 0x82, 2, (512, 2), 0))
    assert function.streams[0].bulk.number == 7


def test_two_cameras_in_one_device_are_two_functions():
    assert len(video_functions(WHOLE + WHOLE)) == 2


def test_inputs_of_several_kinds_have_the_names_of_their_connectors():
    ((function,)) = video_functions(WHOLE)
    function.terminals.update({1: 0x0201, 2: 0x0402, 4: 0x0999})
    assert [i.name for i in list_inputs(function)] == ["Camera", "S-Video", "Composite", "Input"]


def test_descriptors_of_other_classes_are_passed_over():
    audio = (
        descriptor(4, 2, 0, 1, 0x01, 2, 0, 0) + descriptor(0x24, 4, *[255] * 30) + descriptor(5, 0x83, 2, (64, 2), 0)
    )
    assert video_functions(WHOLE + audio) == video_functions(WHOLE)
    assert video_functions(audio) == []


def test_a_size_without_a_usable_interval_or_beyond_reason_is_left_out():
    device = FakeUvcDevice(encodings=("YUYV",), sizes=((0, 48), (64, 48), (20_000, 10)), intervals=(0, 400_000))
    ((f,)) = video_functions(device.configuration_descriptor())[0].streams[0].formats
    assert [(s.width_px, s.intervals) for s in f.sizes] == [(64, (400_000,))]


def sensible(functions):
    for stream in (s for f in functions for s in f.streams):
        for a in stream.alternates:
            assert a.packet_bytes > 0
            assert a.endpoint & 0x80
        for size in (s for f in stream.formats for s in f.sizes):
            assert min(size.width_px, size.height_px, size.default_interval, *size.intervals) > 0


@settings(max_examples=300)
@given(st.binary(max_size=300))
def test_no_bytes_make_it_fail(raw):
    sensible(video_functions(raw))


@settings(max_examples=300)
@given(st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(0, 255)), max_size=8), st.integers(0, len(WHOLE)))
def test_neither_do_those_of_a_device_that_are_cut_off_or_wrong_here_and_there(changes, length):
    raw = bytearray(WHOLE)
    for at, value in changes:
        raw[at] = value
    functions = video_functions(bytes(raw[:length]))
    sensible(functions)
    for function in functions:
        assert len(list_inputs(function)) == len(function.pins)


@given(st.integers(0, len(WHOLE)))
def test_what_stands_before_a_cut_is_read_as_without_it(length):
    cut = video_functions(WHOLE[:length])
    for seen, whole in zip(cut, video_functions(WHOLE), strict=False):
        for stream, other in zip(seen.streams, whole.streams, strict=False):
            assert [f.code for f in stream.formats] == [f.code for f in other.formats][: len(stream.formats)]
