"""The ledger among honest and forging senders: an honest chunk is stored once, and counters balance."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any
from unittest import mock

import pytest
from athrl_protocol import Chunk, InvalidMessage
from athrl_protocol.delivery import ledger as ledger_module
from athrl_protocol.delivery.ledger import LIVING_SECONDS, Known, Ledger, New
from athrl_protocol.messages.keys import CLOCK_DIFFERENCE_SECONDS
from hypothesis import settings
from hypothesis import strategies as some
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

START = 1_700_000_000.0
KEPT = 3
LARGEST = 7
ACTORS = ("actor-1", "actor-2", "actor-3")
NANOSECONDS = 10**9


class _Clock:
    """Both clocks of a ledger; both tell unix seconds."""

    def __init__(self) -> None:
        self.now = START

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> _Clock:
    return _Clock()


@pytest.fixture
def numbered(make_chunk: Callable[..., Chunk]) -> Callable[..., Chunk]:
    def make(incarnation: int, sequence: int = 0, actor: str = "actor-1", oldest_held: int = 0) -> Chunk:
        return dataclasses.replace(
            make_chunk(), actor=actor, incarnation=incarnation, sequence=sequence, oldest_held=oldest_held
        )

    return make


def _take(ledger: Ledger, chunk: Chunk) -> bool:
    """Do what the intake does; return whether the chunk is stored now."""
    if not isinstance(ledger.hear(chunk), New):
        return False
    ledger.record(chunk)
    return True


def test_incarnation_from_the_future_is_refused_by_name(
    clock: _Clock, numbered: Callable[..., Chunk]
) -> None:
    ledger = Ledger(clock=clock, wall_clock=clock)
    latest = int((START + CLOCK_DIFFERENCE_SECONDS) * NANOSECONDS)
    for incarnation in (2**64 - 1, 2**63, latest + 10 * NANOSECONDS):
        with pytest.raises(
            InvalidMessage, match=rf"actor 'actor-1'.*{incarnation} begins at .* at most a day"
        ):
            ledger.hear(numbered(incarnation))
    assert ledger.to_json() == {}
    assert _take(ledger, numbered(latest - NANOSECONDS))


def test_lost_chunks_that_are_made_up_stay_countable(clock: _Clock, numbered: Callable[..., Chunk]) -> None:
    ledger = Ledger(clock=clock, wall_clock=clock)
    with pytest.raises(InvalidMessage, match=f"'actor-1': sequence is {2**40}, should be below {2**40}"):
        ledger.hear(numbered(1, sequence=2**40, oldest_held=2**40))
    for incarnation in range(1, 100):
        assert _take(ledger, numbered(incarnation, sequence=2**40 - 1, oldest_held=2**40 - 1))
    assert ledger.totals.lost < 2**53  # exact as a metric, too


@pytest.mark.parametrize("mine", [1, int(START * NANOSECONDS)])
def test_living_incarnation_stays_however_many_come_under_its_name(
    clock: _Clock, numbered: Callable[..., Chunk], monkeypatch: pytest.MonkeyPatch, mine: int
) -> None:
    monkeypatch.setattr(ledger_module, "INCARNATIONS_KEPT", 64)
    ledger = Ledger(clock=clock, wall_clock=clock)
    assert _take(ledger, numbered(mine))
    refused = 0
    for forged in range(2, 600):
        if forged % 200 == 0:
            clock.now += LIVING_SECONDS / 2
            assert ledger.hear(numbered(mine)) == Known(1)
        try:
            _take(ledger, numbered(forged))
        except InvalidMessage:
            refused += 1
    assert refused > 300
    with pytest.raises(InvalidMessage, match=r"'actor-1' has \d+ incarnations .* no place for 600"):
        ledger.hear(numbered(600))
    assert ledger.hear(numbered(mine)) == Known(1)
    assert ledger.totals.lost == 0


def test_one_name_takes_no_place_from_another(
    clock: _Clock, numbered: Callable[..., Chunk], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ledger_module, "INCARNATIONS_KEPT", 64)
    ledger = Ledger(clock=clock, wall_clock=clock)
    for forged in range(1, ledger_module.INCARNATIONS_KEPT + 1):
        assert _take(ledger, numbered(forged))
    with pytest.raises(InvalidMessage, match="there is no place"):
        ledger.hear(numbered(forged + 1))
    assert _take(ledger, numbered(forged + 1, actor="actor-2"))


def test_ledger_of_an_earlier_checkpoint_is_living(clock: _Clock, numbered: Callable[..., Chunk]) -> None:
    saved = {"actor-1": {str(number): 5 for number in range(64)}, "actor-2": {str(2**64 - 1): 1}}
    ledger = Ledger(saved, {"stored": 320, "transitions": 1, "refused": 0, "lost": 1}, clock, clock)
    assert ledger.to_json() == saved
    assert ledger.hear(numbered(7, sequence=4)) == Known(5)
    assert ledger.hear(numbered(2**64 - 1, actor="actor-2")) == Known(
        1
    )  # known is known, whatever its number
    assert _take(ledger, numbered(7, sequence=5))


@pytest.mark.parametrize("actor", ["actor-1", "another"])
def test_chunk_of_a_forgotten_incarnation_is_not_stored_again(
    clock: _Clock, numbered: Callable[..., Chunk], monkeypatch: pytest.MonkeyPatch, actor: str
) -> None:
    """Whether its name has other incarnations or is forgotten with it, and after a restart, too."""
    monkeypatch.setattr(ledger_module, "INCARNATIONS_KEPT", 2)
    monkeypatch.setattr(ledger_module, "LARGEST_LEDGER", 3)
    ledger = Ledger(clock=clock, wall_clock=clock)
    old = numbered(5, actor=actor)
    assert _take(ledger, old)
    clock.now += LIVING_SECONDS
    for other, incarnation in (("actor-1", 7), ("actor-1", 8), ("actor-2", 9)):
        assert _take(ledger, numbered(incarnation, actor=other))
    for same in (ledger, Ledger(ledger.to_json(), ledger.totals_to_json(), clock, clock)):
        with pytest.raises(InvalidMessage, match=f"'{actor}'.* 5 may be one that was forgotten"):
            same.hear(old)
    clock.now += LIVING_SECONDS
    assert _take(ledger, numbered(int(clock.now * NANOSECONDS), actor=actor))


def _forged_incarnations() -> some.SearchStrategy[int]:
    """Of all times, more than the ledger keeps."""
    days = some.integers(-6, 1).map(lambda day: int((START + 86_400 * day + 0.5) * NANOSECONDS))
    return some.one_of(some.integers(1, 20), days, days, some.integers(2**64 - 4, 2**64 - 1))


@dataclasses.dataclass
class _Sender:
    """One process: what it made and still holds."""

    actor: str
    incarnation: int
    honest: bool
    made: int = 0
    oldest_held: int = 0


@settings(max_examples=30, stateful_step_count=50, deadline=None)
class LedgerAmongForgers(RuleBasedStateMachine):
    """A small ledger; honest senders are heard at least every `LIVING_SECONDS`, forgers do as they like."""

    def __init__(self) -> None:
        super().__init__()
        self.bounds = mock.patch.multiple(ledger_module, INCARNATIONS_KEPT=KEPT, LARGEST_LEDGER=LARGEST)
        self.bounds.start()
        self.clock = _Clock()
        self.ledger = Ledger(clock=self.clock, wall_clock=self.clock)
        self.senders: list[_Sender] = []
        self.stored: list[tuple[str, int, int]] = []
        self.acknowledged: set[tuple[str, int, int]] = set()
        self.heard = 0
        self.settled = 0  # sequences below the next ones, of forgotten incarnations too

    def teardown(self) -> None:
        self.bounds.stop()

    @initialize(actors=some.lists(some.sampled_from(ACTORS), min_size=1, max_size=2, unique=True))
    def honest_actors_begin(self, actors: list[str]) -> None:
        """Each is heard once before anybody forges."""
        for actor in actors:
            self.begin(actor)
            self.honest_sender_sends(len(self.senders) - 1, sent_again=False)

    def begin(self, actor: str) -> None:
        self.clock.now += 1
        self.senders.append(_Sender(actor, int(self.clock.now * NANOSECONDS), honest=True))

    @property
    def honest(self) -> list[_Sender]:
        return [sender for sender in self.senders if sender.honest]

    @rule(which=some.integers(0, 9), sent_again=some.booleans())
    def honest_sender_sends(self, which: int, sent_again: bool) -> None:
        """Send the oldest chunk that is held, or one that is acknowledged, as a delayed query would."""
        sender = self.honest[which % len(self.honest)]
        if sent_again and sender.made:
            sequence = sender.made - 1
        else:
            sequence = sender.made
            sender.made += 1
        name = (sender.actor, sender.incarnation, sequence)
        verdict = self.hear(*name, oldest_held=min(sequence, sender.oldest_held))
        assert isinstance(verdict, New) == (name not in self.acknowledged)
        self.acknowledged.add(name)
        sender.oldest_held = sender.made

    @rule(
        actor=some.sampled_from(ACTORS),
        incarnations=some.lists(_forged_incarnations(), min_size=1, max_size=5),
        sequence=some.sampled_from([0, 0, 0, 1, 2**39, 2**62]),
        held=some.booleans(),
    )
    def forger_sends(self, actor: str, incarnations: list[int], sequence: int, held: bool) -> None:
        """Under any name, with any incarnation that it cannot know to be an honest one's."""
        honest = {sender.incarnation for sender in self.honest}
        for incarnation in incarnations:
            if incarnation not in honest:
                with contextlib.suppress(InvalidMessage):
                    self.hear(actor, incarnation, sequence, 0 if held else sequence)

    @precondition(lambda self: self.stored)
    @rule(which=some.integers(0, 99))
    def forger_replays(self, which: int) -> None:
        """A logged chunk, as it was or as the oldest that is held."""
        actor, incarnation, sequence = self.stored[which % len(self.stored)]
        for held in (0, sequence):
            with contextlib.suppress(InvalidMessage):  # it is forgotten
                assert not isinstance(self.hear(actor, incarnation, sequence, held), New)

    @rule(seconds=some.sampled_from([1.0, LIVING_SECONDS / 2, LIVING_SECONDS]))
    def time_passes(self, seconds: float) -> None:
        """All honest senders are heard in between."""
        self.clock.now += seconds - 0.1
        for which in range(len(self.honest)):
            self.honest_sender_sends(which, sent_again=True)
        self.clock.now += 0.1

    @rule()
    def learner_is_restarted(self) -> None:
        self.ledger = Ledger(
            self.ledger.to_json(), self.ledger.totals_to_json(), self.clock, wall_clock=self.clock
        )

    def hear(self, actor: str, incarnation: int, sequence: int, oldest_held: int) -> object:
        chunk: Any = _Numbers(actor, incarnation, sequence, oldest_held)
        verdict = self.ledger.hear(chunk)
        if isinstance(verdict, New):
            self.settled += sequence + 1 - self.ledger.next_sequence(actor, incarnation)
            self.ledger.record(chunk)
            self.stored.append((actor, incarnation, sequence))
        return verdict

    @invariant()
    def honest_chunks_are_stored_once(self) -> None:
        for sender in self.honest:
            own = [name for name in self.stored if name[:2] == (sender.actor, sender.incarnation)]
            assert [sequence for *_, sequence in own] == list(range(sender.made))

    @invariant()
    def nothing_is_stored_twice(self) -> None:
        assert len(self.stored) == len(set(self.stored))

    @invariant()
    def counters_balance(self) -> None:
        totals = self.ledger.totals
        assert totals.stored == len(self.stored)
        assert totals.stored + totals.refused + totals.lost == self.settled

    @invariant()
    def memory_is_bounded(self) -> None:
        kept = self.ledger.to_json()
        kept.pop("*", None)
        assert sum(map(len, kept.values())) <= LARGEST
        assert all(len(incarnations) <= KEPT for incarnations in kept.values())


TestLedgerAmongForgers = LedgerAmongForgers.TestCase


class _Numbers:
    """The numbers of a chunk without its columns."""

    length = 1

    def __init__(self, actor: str, incarnation: int, sequence: int, oldest_held: int) -> None:
        self.actor, self.incarnation = actor, incarnation
        self.sequence, self.oldest_held = sequence, oldest_held
