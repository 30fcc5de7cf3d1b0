from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from service.acquisition.ledger import Account, Ledger, Outcome
from tests.fakes.scripted import make_frame


class AnyHistory(RuleBasedStateMachine):
    """Whatever the source numbers and whatever becomes of its frames, the account agrees with a plain recount."""

    def __init__(self):
        super().__init__()
        self.ledger, self.waiting, self.streams, self.fates, self.bad = Ledger(), [], [[]], [], 0

    @rule(gap=st.integers(0, 3), numbered=st.booleans(), bad=st.booleans())
    def arrive(self, gap, numbered, bad):
        numbers = [n for n in self.streams[-1] if n is not None]
        sequence = (numbers[-1] + gap if numbers else gap) if numbered else None
        frame = make_frame(sequence, defect="bad" if bad else None)
        self.ledger.arrived(frame)
        self.streams[-1].append(sequence)
        self.bad += bad
        if not bad:
            self.waiting.append(frame)

    @rule()
    def restart(self):
        self.ledger.begin_stream()
        self.streams.append([])

    @rule(outcome=st.sampled_from(Outcome), which=st.integers(0, 99))
    def settle(self, outcome, which):
        if self.waiting:
            self.ledger.settle(self.waiting.pop(which % len(self.waiting)), outcome)
            self.fates.append(outcome)

    @invariant()
    def agrees_with_a_recount(self):
        account = self.ledger.account()
        numbers = [{n for n in stream if n is not None} for stream in self.streams]
        spans = [set(range(min(n), max(n) + 1)) for n in numbers if n]
        delivered = sum(map(len, self.streams))
        assert account.balanced()
        assert account.span == sum(map(len, spans))
        assert account.lost == sum(map(len, spans)) - sum(map(len, numbers))
        assert account.delivered == delivered
        assert account.unnumbered == delivered - sum(map(len, numbers))
        assert account.corrupt == self.bad
        assert account.in_flight == len(self.waiting)
        assert [getattr(account, o) for o in Outcome] == [self.fates.count(o) for o in Outcome]


TestAnyHistory = AnyHistory.TestCase


def test_a_gap_in_the_numbers_is_lost_by_the_device():
    ledger = Ledger()
    for sequence in (10, 11, 14):
        ledger.arrived(make_frame(sequence))
    account = ledger.account()
    assert (account.span, account.delivered, account.lost) == (5, 3, 2)


def test_what_happened_between_two_streams_is_not_called_lost():
    ledger = Ledger()
    ledger.arrived(make_frame(100))
    ledger.begin_stream()
    ledger.arrived(make_frame(0))
    account = ledger.account()
    assert (account.span, account.lost) == (2, 0)
    assert account.balanced()


def test_a_frame_settled_twice_shows():
    ledger, frame = Ledger(), make_frame(0)
    ledger.arrived(frame)
    ledger.settle(frame, Outcome.PROCESSED)
    assert ledger.account().balanced()
    ledger.settle(frame, Outcome.SUPERSEDED)
    assert not ledger.account().balanced()


@given(st.sampled_from(["span", "delivered", "processed", "corrupt", "lost"]), st.integers(1, 5))
def test_any_frame_too_many_unbalances_and_is_said(field, excess):
    sound = Account(span=9, delivered=8, lost=1, processed=5, superseded=1, corrupt=1, failed=1)
    assert sound.balanced()
    wrong = replace(sound, **{field: getattr(sound, field) + excess})
    assert not wrong.balanced()
    assert f"NOT BALANCED: {wrong.unaccounted} unaccounted" in wrong.lines()[1]


def test_an_account_is_a_snapshot():
    ledger = Ledger()
    before = ledger.account()
    ledger.arrived(make_frame(0))
    assert before.delivered == 0
    with pytest.raises(FrozenInstanceError):
        before.delivered = 1


def test_the_summary_prints_both_equations():
    numbers, fates = Account(span=1204, delivered=1200, lost=4, processed=1150, superseded=48, corrupt=2).lines()
    assert numbers == "1,204 numbered by the source = 1,200 delivered + 4 lost"
    assert fates.startswith("1,200 delivered = 1,150 processed + 48 superseded + 0 too old + 2 corrupt + 0 failed")
    assert fates.endswith("every frame accounted for")
