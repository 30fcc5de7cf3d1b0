import threading

import pytest

from service.acquisition.slot import FrameQueue, NewestSlot
from tests.fakes.scripted import PATIENCE_S, make_frame


def test_the_newest_frame_wins_and_the_displaced_one_comes_back():
    slot, first, second = NewestSlot(), make_frame(1), make_frame(2)
    assert slot.put(first) is None
    assert slot.put(second) is first
    assert slot.depth == 1
    assert slot.take(0) is second
    assert slot.take(0) is None


def test_a_bad_frame_never_displaces_a_sound_one_but_gives_way_to_it():
    slot, sound, bad = NewestSlot(), make_frame(1), make_frame(2, defect="torn")
    slot.put(sound)
    assert slot.put(bad) is bad
    assert slot.take(0) is sound
    slot.put(bad)
    assert slot.put(sound) is bad
    assert slot.take(0) is sound


def test_closing_keeps_what_waits_and_turns_away_what_comes():
    slot = NewestSlot()
    slot.put(make_frame(1))
    slot.close()
    assert not slot.exhausted
    late = make_frame(2)
    assert slot.put(late) is late
    assert slot.take(0).sequence == 1
    assert slot.exhausted


@pytest.mark.parametrize("make", [NewestSlot, lambda: FrameQueue(1)])
@pytest.mark.parametrize("wake", [lambda h: h.put(make_frame(7)), lambda h: h.close()], ids=["put", "close"])
def test_a_waiting_consumer_is_woken(make, wake):
    hand_over, got = make(), []
    consumer = threading.Thread(target=lambda: got.append(hand_over.take(60)))
    consumer.start()
    wake(hand_over)
    consumer.join(PATIENCE_S)
    assert not consumer.is_alive()
    assert [frame and frame.sequence for frame in got] in ([7], [None])


def test_a_queue_keeps_the_order_and_counts_what_it_has_no_room_for():
    queue = FrameQueue(2)
    assert [queue.offer(make_frame(i)) for i in range(4)] == [True, True, False, False]
    assert queue.overflowed == 2
    assert [queue.take(0).sequence for _ in range(2)] == [0, 1]
    assert queue.take(0) is None


def test_a_producer_waits_for_room_and_gets_its_frame_back_when_the_queue_closes():
    queue, back = FrameQueue(1), []
    queue.put(make_frame(0))
    producer = threading.Thread(target=lambda: back.extend([queue.put(make_frame(1)), queue.put(make_frame(2))]))
    producer.start()
    assert queue.take(PATIENCE_S).sequence == 0
    while queue.depth == 0:
        pass
    queue.close()
    producer.join(PATIENCE_S)
    assert [frame and frame.sequence for frame in back] == [None, 2]
    assert queue.take(0).sequence == 1
    assert queue.exhausted
    assert not queue.offer(make_frame(3))


def test_a_queue_without_room_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        FrameQueue(0)
