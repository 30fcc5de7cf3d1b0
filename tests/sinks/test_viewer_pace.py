import itertools
import socket

from service.sinks.viewer_pace import BACKLOG_BYTES, Pace, backlog_bytes

TABLE = """\
  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode
   0: 0100007F:2694 00000000:0000 0A 00000000:00000005 00:00000000 00000000     0        0 1 1 0 100 0 0 10 0
   1: 0100007F:2694 0100007F:B3FE 01 00000100:00000007 00:00000000 00000000     0        0 2 1 0 20 4 0 10 -1
   2: 0100007F:B3FE 0100007F:2694 01 00000009:00000200 00:00000000 00000000     0        0 3 1 0 20 4 0 10 -1
   3: 0100007F:2694 0200007F:B400 01 00000080:00000000 00:00000000 00000000     0        0 4 1 0 20 4 0 10 -1
   4: 0100007F:1F90 0100007F:B402 01 0000FFFF:00000000 00:00000000 00000000     0        0 5 1 0 20 4 0 10 -1
"""


class Time:
    now_s = 100.0

    def __call__(self):
        return self.now_s


def due(pace, clock, seconds, step_s=0.04):
    """Which frames are sent over some seconds of 25 frames/s."""
    said = []
    for _ in range(round(seconds / step_s)):
        said.append(pace.due())
        clock.now_s += step_s
    return said


def test_the_backlog_is_what_the_slowest_client_has_not_read(tmp_path):
    table = tmp_path / "tcp"
    table.write_text(TABLE)
    assert backlog_bytes(0x2694, table) == 0x100 + 0x200
    assert backlog_bytes(0x2695, table) == 0


def test_a_client_that_does_not_read_shows_in_the_kernels_own_tables():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        with socket.create_connection(server.getsockname()) as client, server.accept()[0] as accepted:
            accepted.sendall(bytes(10_000))
            assert backlog_bytes(server.getsockname()[1]) == 10_000
            client.recv(10_000, socket.MSG_WAITALL)
            assert backlog_bytes(server.getsockname()[1]) == 0


def test_every_frame_is_sent_while_viewers_keep_up():
    clock = Time()
    assert all(due(Pace(1, lambda port: BACKLOG_BYTES, clock), clock, 4))


def test_a_frame_on_its_way_at_the_moment_is_no_backlog():
    clock = Time()
    looks = itertools.cycle([10**6, 10**6, 0])
    assert all(due(Pace(1, lambda port: next(looks), clock), clock, 8))


def test_a_viewer_behind_gets_two_frames_a_second_until_it_has_caught_up():
    clock, waiting = Time(), [BACKLOG_BYTES + 1]
    pace = Pace(1, lambda port: waiting[0], clock)
    assert sum(due(pace, clock, 1)) == 25  # a second goes by before it is believed
    assert 7 <= sum(due(pace, clock, 4)) <= 9
    waiting[0] = 0
    due(pace, clock, 0.52)
    assert all(due(pace, clock, 2))


def test_the_kernel_is_asked_twice_a_second():
    clock, asked = Time(), []
    due(Pace(7, lambda port: asked.append(port) or 0, clock), clock, 4)
    assert len(asked) <= 8
    assert set(asked) == {7}
