"""What is missing, and when."""

from dataclasses import replace

from drivers.frame import Field, PixelFormat
from drivers.session_index import Fault, Measured, Overflow, Row, Stream
from service.report.losses import MOST_LOSSES, Losses

S = 1_000_000_000
STREAM = Stream("cam", (64, 48), PixelFormat.MONO8)
FIRST = Row(0, 0, 1, 0, 0, 0, Field.PROGRESSIVE, None, 0, "000000.mkv", 0, 0, STREAM)


def row(number, sequence, at_s, **more):
    return replace(FIRST, number=number, sequence=sequence, wall_ns=int(at_s * S), **more)


def taken(*items):
    losses = Losses()
    for item in items:
        losses.take(item)
    return losses


def test_what_the_source_counted_is_missed():
    losses = taken(row(0, 10, 0), row(1, 11, 0.1), row(2, 15, 0.3), row(3, 16, 0.4))
    assert losses.totals == {Losses.MISSING: 3}
    (loss,) = losses.listed
    assert (loss.frames, loss.from_ns, loss.until_ns) == (3, S // 10, 3 * S // 10)


def test_a_source_that_was_reopened_counts_anew():
    assert taken(row(0, 90, 0), row(1, 0, 0.1, generation=2), row(2, 500, 0.2, generation=3)).totals == {}


def test_a_source_that_does_not_count_misses_nothing_that_is_known():
    losses = taken(row(0, None, 0), row(1, None, 0.1))
    assert losses.totals == {}
    assert not losses.numbered


def test_silence_is_told_with_its_length():
    losses = taken(row(0, 0, 0), row(1, 1, 7.5))
    assert losses.totals == {Losses.SILENT: 1}
    assert losses.listed[0].until_ns - losses.listed[0].from_ns == 7.5 * S


def test_all_that_the_index_tells_is_summed():
    losses = taken(
        row(0, 0, 0), Overflow(3), row(1, 4, 0.2), Overflow(2), Measured(None, 0, 0, 0), Fault(9, "was changed"),
        Fault(10, "is cut short", torn=True), row(2, 7, 0.4, defect="truncated"),
    )  # fmt: skip
    assert losses.totals == {
        Losses.NO_ROOM: 5, Losses.MISSING: 5, Losses.UNKNOWN: 1, Losses.FAULTS: 1, f"{Losses.BAD}: truncated": 1
    }  # fmt: skip
    assert sum(loss.frames for loss in losses.listed if loss.kind == Losses.NO_ROOM) == 5


def test_what_is_close_together_is_one_and_the_list_is_bounded():
    near = taken(*(row(k, 2 * k, 0.1 * k) for k in range(50)))
    assert [loss.frames for loss in near.listed] == [49]
    far = taken(*(row(k, 2 * k, 60 * k) for k in range(500)))
    assert len(far.listed) == MOST_LOSSES
    assert far.totals[Losses.MISSING] == 499
