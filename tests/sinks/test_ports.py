import socket

import pytest

from drivers.errors import ConfigError
from service.sinks.ports import falls_silent, free_port, is_loopback, listens

HERE = "127.0.0.1"


@pytest.fixture
def taken():
    with socket.socket() as s:
        s.bind((HERE, 0))
        s.listen()
        yield s.getsockname()[1]


def test_a_taken_default_gives_way_to_the_next_free_port(taken):
    assert taken < free_port(HERE, None, taken, "port") <= taken + 49


def test_a_port_that_was_asked_for_is_not_changed_in_silence(taken):
    with pytest.raises(ConfigError, match=f"viewer port = {taken} at {HERE}: Address already in use; name another"):
        free_port(HERE, taken, 9876, "viewer port")


def test_an_address_that_is_not_ours_is_refused():
    with pytest.raises(ConfigError, match=r"port = 9876 to 9925 at 192\.0\.2\.1: Cannot assign"):
        free_port("192.0.2.1", None, 9876, "port")


def test_a_port_left_a_moment_ago_is_free():
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as rerun's server and our page's do
        server.bind((HERE, 0))
        server.listen()
        port = server.getsockname()[1]
        with socket.create_connection((HERE, port)) as client, server.accept()[0] as accepted:
            accepted.close()  # the side that closes first keeps the port in TIME_WAIT
            assert client.recv(1) == b""
    assert free_port(HERE, port, port, "port") == port


def test_what_listens_is_told_from_what_does_not(taken):
    assert listens(HERE, taken, 5.0)
    assert not falls_silent(HERE, taken, 0.05)
    with socket.socket() as s:
        s.bind((HERE, 0))
        assert not listens(HERE, s.getsockname()[1], 0.05)
        assert falls_silent(HERE, s.getsockname()[1], 5.0)


def test_loopback_is_told_from_what_others_reach():
    assert is_loopback("127.0.0.1")
    assert is_loopback("127.1.2.3")
    assert not any(is_loopback(a) for a in ("0.0.0.0", "192.168.1.4", "::1", "localhost", ""))
