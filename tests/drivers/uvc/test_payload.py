"""Frames come together from payloads however these are cut, and no byte of a device's makes the assembler fail."""

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.uvc.payload import FrameAssembler, HeaderBit, payload_header

FRAME_BYTES = 100
TAIL = 3
"""Bytes of header that are neither time: they are passed over."""


def payload(data: bytes, fid: int, *, eof: bool = False, error: bool = False, size: int = 2) -> bytes:
    bits = fid | (HeaderBit.EOF if eof else 0) | (HeaderBit.ERR if error else 0) | HeaderBit.EOH
    return bytes([size, bits]) + bytes(size - 2) + data


def frame(number: int, size: int = FRAME_BYTES) -> bytes:
    return bytes((number * 7 + i) % 251 for i in range(size))


def assemble(transfers, assembler=None, least=FRAME_BYTES):
    """Feed (bytes, ends) each; gives the frames."""
    assembler = assembler or FrameAssembler(least, FRAME_BYTES)
    return [f for at, (data, ends) in enumerate(transfers) for f in assembler.feed(data, at, ends=ends)]


def cut(data: bytes, places) -> list[bytes]:
    edges = [0, *sorted({p % (len(data) + 1) for p in places}), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


cuts = st.lists(st.integers(0, 1000), max_size=5)


@given(
    st.lists(st.tuples(cuts, st.booleans(), st.integers(2, 20), cuts), min_size=2, max_size=6),
    st.integers(0, 1),
)
def test_however_payloads_and_reads_are_cut_the_frames_come_out(frames, fid):
    """A payload is cut into reads, a frame into payloads; the end of frame is told or shows in the toggle alone."""
    transfers, last = [], len(frames) - 1
    for number, (into_payloads, tells_end, header_size, into_reads) in enumerate(frames):
        parts = [p for p in cut(frame(number), into_payloads) if p]
        for n, part in enumerate(parts):
            eof = n == len(parts) - 1 and (tells_end or number == last)
            whole = payload(part, (fid + number) % 2, eof=eof, size=header_size)
            # a header comes in one piece: the first packet of a payload holds it
            head, *rest = whole[: header_size + 1], *cut(whole[header_size + 1 :], into_reads)
            transfers += [(piece, False) for piece in (head, *rest)]
            transfers[-1] = (transfers[-1][0], True)
    found = assemble(transfers)
    assert [bytes(f.data) for f in found] == [frame(n) for n in range(len(frames))]
    assert [f.number for f in found] == list(range(len(frames)))
    assert {f.flaw for f in found} == {None}


@settings(max_examples=300)
@given(st.lists(st.tuples(st.binary(max_size=40), st.booleans()), max_size=40))
def test_whatever_a_device_sends_frames_stay_bounded_and_numbers_grow(transfers):
    found = assemble(transfers, FrameAssembler(0, 64))
    assert all(0 < len(f.data) <= 64 for f in found)
    numbers = [f.number for f in found]
    assert all(a < b for a, b in itertools.pairwise(numbers))
    assert len(found) <= 2 * len(transfers)


@given(st.lists(st.sampled_from(["whole", "short", "long", "error", "empty", "headless", "no end"]), max_size=12))
def test_every_frame_after_the_first_is_delivered_or_leaves_a_gap_and_is_marked_where_it_is_not_whole(kinds):
    """The ledger of a stream: frames begun = frames given + gaps in their numbers."""
    kinds = ["whole", *kinds, "whole"]
    transfers = []
    for number, kind in enumerate(kinds):
        data = {"short": frame(number)[:60], "long": frame(number, 130), "empty": b""}.get(kind, frame(number))
        fid, half = number % 2, len(data) // 2
        transfers.append((payload(data[:half], fid, error=kind == "error"), True))
        if kind == "headless":
            transfers.append((b"\x01\x00" + b"?" * 20, True))
        transfers.append((payload(data[half:], fid, eof=kind != "no end"), True))
    found = {f.number: f for f in assemble(transfers)}
    assert set(found) == {n for n, kind in enumerate(kinds) if kind != "empty"}
    flaws = {"long": "more than 100 bytes", "error": "marked it as bad", "headless": "without a proper header"}
    for number, f in found.items():
        kind = kinds[number]
        assert flaws[kind] in f.flaw if kind in flaws else f.flaw is None
        assert len(f.data) == (60 if kind == "short" else FRAME_BYTES)


def test_a_stream_joined_midway_begins_with_the_next_whole_frame():
    transfers = [(payload(frame(0)[70:], 0, eof=True), True), (payload(frame(1), 1, eof=True), True)]
    ((found,)) = assemble(transfers)
    assert (bytes(found.data), found.number) == (frame(1), 0)


def test_only_the_first_frame_may_be_passed_over():
    transfers = [(payload(frame(n)[:70], n % 2, eof=True), True) for n in range(3)]
    assert [(len(f.data), f.number) for f in assemble(transfers)] == [(70, 0), (70, 1)]


def test_a_compressed_stream_is_joined_where_a_picture_begins():
    assembler = FrameAssembler(0, 1000, b"\xff\xd8")
    found = assemble(
        [(payload(d, n % 2, eof=True), True) for n, d in enumerate([b"rest", b"\xff\xd8ab", b"?"])], assembler
    )
    assert [(bytes(f.data), f.number) for f in found] == [(b"\xff\xd8ab", 0), (b"?", 1)]


def test_what_follows_the_end_of_a_frame_without_picture_belongs_to_none():
    transfers = [
        (payload(frame(0), 0, eof=True), True), (payload(b"", 0, eof=True), True), (b"", True),
        (payload(b"", 0), True), (payload(frame(1), 1, eof=True), True),
    ]  # fmt: skip
    assert [f.number for f in assemble(transfers)] == [0, 1]


def test_a_device_that_never_toggles_is_read_by_the_ends_of_its_frames():
    assert [f.number for f in assemble([(payload(frame(n), 0, eof=True), True) for n in range(3)])] == [0, 1, 2]


def test_a_frame_that_begins_without_a_header_is_marked():
    transfers = [(payload(frame(0), 0, eof=True), True), (b"\x01??", True), (payload(frame(1), 1, eof=True), True)]
    assert [f.flaw for f in assemble(transfers)] == [None, "a part of it came without a proper header"]


def test_what_has_begun_can_be_skipped():
    assembler = FrameAssembler(FRAME_BYTES, FRAME_BYTES)
    assemble([(payload(frame(0), 0, eof=True), True), (payload(frame(1)[:50], 1), True)], assembler)
    assembler.skip()
    found = assemble([(payload(frame(1)[50:], 1, eof=True), True), (payload(frame(2), 0, eof=True), True)], assembler)
    assert [bytes(f.data) for f in found] == [frame(2)]


def test_so_can_the_rest_of_a_payload():
    assembler = FrameAssembler(FRAME_BYTES, FRAME_BYTES)
    assemble([(payload(frame(0), 0, eof=True), True), (payload(frame(1)[:50], 1), False)], assembler)
    assembler.skip()
    found = assemble([(frame(1)[50:], True), (payload(frame(2), 0, eof=True), True)], assembler)
    assert [(bytes(f.data), f.flaw) for f in found] == [(frame(2), None)]


def test_the_times_of_a_frame_are_those_of_its_first_payload():
    times = (77).to_bytes(4, "little") + (99).to_bytes(4, "little") + b"\0\0"
    first = bytes([12, 0x8C]) + times + frame(0)[:50]
    transfers = [(first, True), (payload(frame(0)[50:], 0, eof=True), True)]
    ((found,)) = assemble(transfers)
    assert (found.captured, found.sent, found.arrived_ns) == (77, 99, 0)


@pytest.mark.parametrize("header", [b"", b"\x02", b"\x00\x80", b"\x01\x80", b"\x0c\x8c\0\0"])
def test_what_is_no_header_is_none(header):
    assert payload_header(header) is None


@given(st.integers(0, 18), st.integers(0, 255), st.binary(min_size=14, max_size=14))
def test_a_header_is_never_longer_than_the_payload_and_has_the_times_that_fit_into_it(size, bits, rest):
    data = bytes([size, bits]) + rest
    header = payload_header(data)
    if header is None:
        assert not 2 <= data[0] <= len(data)
        return
    assert header.size_bytes == data[0]
    assert (header.captured is not None) == bool(data[1] & 4 and data[0] >= 6)
    assert (header.sent is not None) == bool(data[1] & 8 and data[0] >= (12 if data[1] & 4 else 8))
