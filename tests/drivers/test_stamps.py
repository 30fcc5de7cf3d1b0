from drivers.stamps import StampCheck, TimeGaps

MS = 1_000_000


def test_a_clock_that_runs_ahead_is_set_back_by_the_most_it_was_ever_seen_ahead():
    stamps = StampCheck()
    pairs = [(100, 101), (140, 120), (180, 182), (220, 215)]
    assert [stamps.check(stamp * MS, received * MS) // MS for stamp, received in pairs] == [100, 120, 160, 200]
    stamps.restart()
    assert stamps.check(300 * MS, 310 * MS) == 300 * MS


def test_a_time_before_the_machine_began_or_far_ahead_is_another_clocks():
    stamps = StampCheck()
    for stamp in (0, -5, 10**18):
        assert stamps.check(stamp, 500 * MS) == 500 * MS
    assert stamps.check(490 * MS, 500 * MS) == 490 * MS


def missing(gaps, frames):
    return [gaps.missing(sequence, time * MS) for sequence, time in frames]


def steady(count, period, start=0):
    return [(start + i, (start + i) * period) for i in range(count)]


def test_a_gap_in_time_without_a_gap_in_the_numbers_is_found():
    gaps = TimeGaps()
    assert not any(missing(gaps, steady(10, 40)))
    assert missing(gaps, [(10, 520), (11, 560), (12, 680)]) == [3, 0, 2]


def test_a_gap_that_the_numbers_tell_is_none():
    gaps = TimeGaps()
    missing(gaps, steady(10, 40))
    assert missing(gaps, [(13, 520), (14, 560)]) == [0, 0]


def test_a_camera_that_slows_down_for_good_is_not_losing_frames_for_good():
    gaps = TimeGaps()
    missing(gaps, steady(10, 40))
    assert sum(missing(gaps, [(10 + i, 400 + 80 * i) for i in range(1, 60)])) <= 5


def test_nothing_is_suspected_of_jitter_of_second_fields_or_before_the_interval_is_known():
    gaps = TimeGaps()
    assert missing(gaps, [(0, 0), (1, 40), (2, 400), (3, 440)]) == [0, 0, 0, 0]
    gaps.restart()
    missing(gaps, steady(12, 40))
    assert missing(gaps, [(11, 460), (12, 495), (13, 521), (13, 541)]) == [0, 0, 0, 0]
