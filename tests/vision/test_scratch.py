"""Memory that is lent for a call: nobody else's meanwhile, and the same again the next time."""

import numpy as np
import pytest

from service.vision import scratch as module
from service.vision.scratch import ALIGNMENT, DOUBLE, SINGLE, Scratch, borrowed


@pytest.fixture(autouse=True)
def idle(monkeypatch):
    monkeypatch.setattr(module, "_idle", [])


def addresses(*arrays):
    return [a.ctypes.data for a in arrays]


def test_arrays_have_the_shape_and_kind_asked_for_and_do_not_overlap():
    scratch = Scratch()
    for _ in range(3):
        a, b, c = (scratch.array(s, k) for s, k in (((2, 3), SINGLE), ((5,), DOUBLE), ((1, 1, 4), SINGLE)))
        assert [(x.shape, x.dtype) for x in (a, b, c)] == [((2, 3), SINGLE), ((5,), DOUBLE), ((1, 1, 4), SINGLE)]
        a[:], b[:], c[:] = 1, 2, 3
        assert (a == 1).all()
        assert (b == 2).all()
        assert all(x.flags.c_contiguous and x.flags.aligned for x in (a, b, c))
        scratch.clear()
    assert not any(address % ALIGNMENT for address in addresses(a, b, c))


def test_the_same_memory_comes_back_once_its_size_is_known():
    seen = []
    for _ in range(4):
        with borrowed() as scratch:
            seen.append(addresses(scratch.array((100, 7), DOUBLE), scratch.array((9,), SINGLE)))
    assert seen[1] == seen[2] == seen[3]


def test_it_grows_when_more_is_asked_for():
    for n in (10, 1000, 10, 100_000, 100_000):
        with borrowed() as scratch:
            a = scratch.array((n,), DOUBLE)
            a[:] = n
            assert a.sum() == n * n


def test_two_at_a_time_have_two():
    with borrowed() as first, borrowed() as second:
        assert first is not second
        a, b = first.array((8,), DOUBLE), second.array((8,), DOUBLE)
        a[:], b[:] = 1, 2
        assert a.sum() == 8
    assert len(module._idle) == 2


def test_it_is_given_back_when_the_work_fails():
    with pytest.raises(ZeroDivisionError), borrowed() as scratch:
        _ = scratch.array((4,), np.dtype(np.int64)) // (1 // 0)
    assert module._idle == [scratch]
