import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import visca
from drivers.visca import Kind, LensBlock, parse_reply, split_packets

low = st.integers(0, 0x7F)
packets = st.builds(
    lambda address, said: bytes((0x80 | address << 4, *said, 0xFF)),
    st.integers(1, 7),
    st.lists(low, min_size=1, max_size=14),
)
noise = st.binary(max_size=60)


def fed(data, cuts):
    found, rest = [], b""
    edges = sorted({0, len(data), *(c for c in cuts if c <= len(data))})
    for start, end in itertools.pairwise(edges):
        more, rest = split_packets(rest + data[start:end])
        found += more
        assert len(rest) <= 15
    return found, rest


@pytest.mark.parametrize(
    ("packet", "octets"),
    [
        (visca.zoom_inquiry(1), "81 09 04 47 FF"),
        (visca.lens_block_inquiry(3), "83 09 7E 7E 00 FF"),
        (visca.autofocus(1, on=False), "81 01 04 38 03 FF"),
        (visca.autofocus(1, on=True), "81 01 04 38 02 FF"),
        (visca.digital_zoom(2, on=False), "82 01 04 06 03 FF"),
        (visca.address_set(), "88 30 01 FF"),
        (visca.interface_clear(), "88 01 00 01 FF"),
    ],
)
def test_packets_are_those_of_the_manual(packet, octets):
    assert packet == bytes.fromhex(octets)


@pytest.mark.parametrize("address", [0, 9, -1])
def test_no_packet_goes_to_an_address_that_there_is_not(address):
    with pytest.raises(ValueError, match="address"):
        visca.zoom_inquiry(address)


@pytest.mark.parametrize(("said", "words"), [((1, 0xFF), "FF ends"), ((0,) * 14, "17 bytes")])
def test_what_is_no_packet_is_not_made(said, words):
    with pytest.raises(ValueError, match=words):
        visca.command(1, *said)


@given(st.lists(packets, max_size=8), st.lists(st.integers(0, 200)))
def test_packets_come_out_as_they_went_in_however_they_arrive(sent, cuts):
    assert fed(b"".join(sent), cuts) == (sent, b"")


@given(noise, packets, st.lists(st.integers(0, 100)))
def test_no_noise_before_a_packet_costs_more_than_what_it_spoils(garbage, packet, cuts):
    found, rest = fed(garbage + packet, cuts)
    assert found[-1] == packet
    assert rest == b""


@given(noise, st.integers(1, 15), packets, packets)
def test_a_packet_broken_off_costs_itself_only(garbage, kept, broken, packet):
    assert split_packets(garbage + broken[: min(kept, len(broken) - 1)] + packet)[0][-1] == packet


@given(st.integers(1, 7), st.lists(low, min_size=15, max_size=60), st.lists(st.integers(0, 80)))
def test_what_is_too_long_is_none(address, said, cuts):
    assert fed(bytes((0x80 | address << 4, *said, 0xFF)), cuts) == ([], b"")


@given(st.binary(max_size=80))
def test_reading_never_fails_whatever_comes(data):
    found, _ = split_packets(data)
    for packet in (data, *found):
        reply = parse_reply(packet)
        if reply is not None:
            visca.zoom_position(reply.payload)
            visca.lens_block(reply.payload)
            if reply.kind is Kind.ERROR:
                visca.explain_error(reply)


@pytest.mark.parametrize(
    ("octets", "address", "kind", "socket", "payload"),
    [
        ("90 41 FF", 1, Kind.ACK, 1, ""),
        ("A0 52 FF", 2, Kind.COMPLETION, 2, ""),
        ("90 50 01 07 08 01 FF", 1, Kind.COMPLETION, 0, "01 07 08 01"),
        ("90 60 02 FF", 1, Kind.ERROR, 0, "02"),
        ("F0 61 41 FF", 7, Kind.ERROR, 1, "41"),
        ("90 38 FF", 1, Kind.OTHER, 8, ""),
        ("90 41 00 FF", 1, Kind.OTHER, 1, "00"),
        ("90 60 FF", 1, Kind.OTHER, 0, ""),
        ("88 30 02 FF", 0, Kind.OTHER, 0, "02"),
        ("88 50 02 FF", 0, Kind.OTHER, 0, "02"),
    ],
)
def test_replies_are_told_apart(octets, address, kind, socket, payload):
    reply = parse_reply(bytes.fromhex(octets))
    assert (reply.address, reply.kind, reply.socket, reply.payload) == (address, kind, socket, bytes.fromhex(payload))


@pytest.mark.parametrize("octets", ["", "FF", "90 FF", "90 41", "10 41 FF", "91 41 FF", "81 09 04 47 FF", "90" * 17])
def test_what_is_no_reply_to_us_is_none(octets):
    assert parse_reply(bytes.fromhex(octets)) is None


@pytest.mark.parametrize(
    ("code", "words"),
    [(1, "length"), (2, "syntax"), (3, "buffer full"), (4, "cancelled"), (0x41, "not executable"), (9, "unknown")],
)
def test_errors_are_told_in_words_and_by_their_number(code, words):
    said = visca.explain_error(parse_reply(bytes((0x90, 0x60, code, 0xFF))))
    assert words in said
    assert f"({code:02X}h)" in said


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF), st.integers(0, 3), st.integers(0, 7))
def test_zoom_and_lens_block_are_read_back(zoom, focus, mode, executing):
    def nibbles(number):
        return bytes(int(c, 16) for c in f"{number:04x}")

    assert visca.zoom_position(nibbles(zoom)) == zoom
    block = visca.lens_block(nibbles(zoom) + b"\x01\x02" + nibbles(focus) + bytes((0, mode, executing)))
    assert block == LensBlock(
        zoom, focus, bool(mode & 1), bool(mode & 2), bool(executing & 1), bool(executing & 2), bool(executing & 4)
    )
    assert block.executing is bool(executing)


@pytest.mark.parametrize(
    "payload", [b"", bytes(3), bytes(5), bytes(12), bytes(14), b"\x10\0\0\0", bytes(9) + b"\x10\0\0\0"]
)
def test_a_payload_of_another_form_says_nothing(payload):
    assert visca.zoom_position(payload) is None
    assert visca.lens_block(payload) is None
