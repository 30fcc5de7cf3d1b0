import numpy as np

from drivers.pool import FramePool, read_only


def test_memory_is_taken_in_turn_while_nobody_holds_it():
    pool = FramePool((4, 6), np.uint8, 3)
    places = [pool.take().ctypes.data for _ in range(6)]
    assert places[:3] == places[3:]
    assert len(set(places)) == 3
    assert pool.overflowed == 0


def test_memory_stays_with_whoever_holds_a_view_a_part_or_a_buffer_of_it():
    pool = FramePool((4, 6), np.uint8, 4)
    held = [read_only(pool.take()), read_only(pool.take())[1:3, ::2], memoryview(read_only(pool.take()))]
    places = {pool.take().ctypes.data for _ in range(9)}
    assert len(places) == 1
    del held
    assert len({pool.take().ctypes.data for _ in range(9)}) == 4


def test_where_all_is_held_there_is_new_memory_which_is_counted():
    pool = FramePool((4, 6), np.uint16, 2)
    held = [read_only(pool.take()) for _ in range(5)]
    assert len({h.__array_interface__["data"][0] for h in held}) == 5
    assert pool.overflowed == 3
    assert held[4].dtype == np.uint16


def test_views_are_read_only():
    view = read_only(FramePool((2, 2), np.uint8, 1).take())
    assert not view.flags.writeable
    assert view.flags.c_contiguous
