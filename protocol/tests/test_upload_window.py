"""Window and ledger together, with a network that loses anything and a learner that goes back in time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from athrl_protocol import Chunk, InvalidMessage, LevelColumns
from athrl_protocol.delivery.ledger import INCARNATIONS_KEPT, Gap, Known, Ledger, New
from athrl_protocol.delivery.upload_window import UploadWindow
from hypothesis import given, settings
from hypothesis import strategies as some


def add(window: UploadWindow, encoded: bytes) -> None:
    """Hold a chunk that is encoded at once."""
    window.put(window.reserve(), encoded)


def test_counts_of_a_window_add_up() -> None:
    window = UploadWindow()
    for content in (b"0", b"1", b"2"):
        add(window, content)
    assert len(window) == 3
    assert window.take() == (0, 0, b"0")
    assert window.take() == (1, 0, b"1")
    window.acknowledge(1)
    window.give_up(1)
    assert window.take() == (2, 2, b"2")
    counts = window.statistics()
    assert (counts.produced, counts.acknowledged, counts.given_up, counts.waiting) == (3, 1, 1, 1)


def test_what_is_given_up_is_counted_by_reason() -> None:
    window = UploadWindow()
    for _ in range(6):
        add(window, b"")
        window.take()
    window.give_up(1)
    window.give_up(1)  # a second refusal of the same chunk
    window.acknowledge(1)
    window.give_up_all("finished")
    add(window, b"")
    window.give_up_all("closed")
    window.leave_out(3)
    counts = window.statistics()
    assert counts.given_up_by_reason == {"invalid": 1, "finished": 4, "closed": 1, "bound": 3}
    assert counts.given_up == 9
    assert counts.produced == 10 == counts.acknowledged + counts.given_up + counts.waiting


def test_acknowledgement_never_drops_what_was_not_sent() -> None:
    window = UploadWindow()
    add(window, b"0")
    add(window, b"1")
    window.take()
    window.acknowledge(99)
    assert window.take() == (1, 1, b"1")


def test_rewind_sends_again_from_the_oldest_held() -> None:
    window = UploadWindow()
    for number in range(5):
        add(window, b"%d" % number)
        window.take()
    window.acknowledge(2)
    window.rewind_to(0)
    assert window.take() == (2, 2, b"2")
    window.rewind_to(4)
    assert window.take() == (4, 2, b"4")
    assert window.statistics().resent == 2


def test_chunk_that_was_turned_away_is_not_counted_as_sent_again_for_want_of_an_answer() -> None:
    window = UploadWindow()
    for number in range(3):
        add(window, b"%d" % number)
        window.take()
    window.rewind(turned_away=True)
    window.take()
    window.rewind(turned_away=True)
    window.take()
    window.rewind()
    window.take()
    counts = window.statistics()
    assert (counts.turned_away, counts.resent) == (2, 1)


@pytest.fixture
def numbered(make_chunk: Callable[..., Chunk]) -> Callable[..., Chunk]:
    def make(sequence: int, oldest_held: int = 0, incarnation: int = 1) -> Chunk:
        return dataclasses.replace(
            make_chunk(), actor="a", incarnation=incarnation, sequence=sequence, oldest_held=oldest_held
        )

    return make


def test_ledger_tells_known_from_new_from_gap(numbered: Callable[..., Chunk]) -> None:
    ledger = Ledger()
    assert ledger.classify(numbered(0)) == New(lost=0)
    ledger.record(numbered(0))
    assert ledger.classify(numbered(0)) == Known(1)
    assert ledger.classify(numbered(2)) == Gap(1)
    assert ledger.classify(numbered(0, incarnation=2)) == New(lost=0)


def test_ledger_counts_what_the_actor_does_not_hold_any_more_as_lost(numbered: Callable[..., Chunk]) -> None:
    ledger = Ledger({"a": {"1": 10}})
    assert ledger.classify(numbered(25, oldest_held=20)) == Gap(20)
    assert ledger.classify(numbered(20, oldest_held=20)) == New(lost=10)
    with pytest.raises(InvalidMessage, match="oldest_held is 30"):
        ledger.classify(numbered(25, oldest_held=30))


def test_ledger_survives_json_and_stays_small(numbered: Callable[..., Chunk]) -> None:
    ledger = Ledger()
    for incarnation in range(INCARNATIONS_KEPT + 10):
        ledger.record(numbered(0, incarnation=incarnation))
    saved = ledger.to_json()
    assert Ledger(saved).to_json() == saved
    assert len(saved["a"]) == INCARNATIONS_KEPT


class _Simulation:
    """One actor and one learner whose messages get lost and whose ledger returns to an older one."""

    def __init__(self, chunk: Chunk) -> None:
        self.chunk = chunk
        self.window = UploadWindow()
        self.ledger = Ledger()
        self.stored: list[int] = []  # what the learner has now
        self.lost: set[int] = set()  # what it counted as lost
        self.acknowledged: set[int] = set()  # what it must have
        self.save()

    def produce(self) -> None:
        if len(self.window) < 6:
            add(self.window, b"")

    def exchange(self, query_arrives: bool, answer_arrives: bool) -> bool:
        """Send one chunk; return whether the actor received the answer."""
        taken = self.window.take()
        if taken is None:
            return True
        sequence, oldest_held, _ = taken
        if not query_arrives:
            self.window.rewind()
            return False
        chunk = dataclasses.replace(self.chunk, sequence=sequence, oldest_held=oldest_held)
        verdict = self.ledger.classify(chunk)
        if isinstance(verdict, New):
            self.stored.append(sequence)
            self.lost |= set(range(sequence - verdict.lost, sequence))
            self.ledger.record(chunk)
        if not answer_arrives:
            self.window.rewind()
            return False
        if isinstance(verdict, Gap):
            self.window.rewind_to(verdict.expected_sequence)
        else:
            following = self.ledger.next_sequence(chunk.actor, chunk.incarnation)
            self.acknowledged |= set(range(following)) - self.lost
            self.window.acknowledge(following)
        return True

    def save(self) -> None:
        self.saved = self.ledger.to_json(), list(self.stored), set(self.lost)

    def crash(self) -> None:
        ledger, stored, lost = self.saved
        self.ledger, self.stored, self.lost = Ledger(ledger), list(stored), set(lost)
        # what was acknowledged after the checkpoint is gone with the learner's memory
        self.acknowledged &= set(stored)


_ACTIONS = ["produce", "produce", "send", "send", "lose query", "lose answer", "save", "crash"]


@settings(max_examples=150, deadline=None)
@given(steps=some.lists(some.sampled_from(_ACTIONS), max_size=80))
def test_nothing_is_lost_or_counted_twice_whatever_dies_when(steps: list[str]) -> None:
    simulation = _Simulation(_any_chunk())
    for step in steps:
        if step == "produce":
            simulation.produce()
        elif step == "save":
            simulation.save()
        elif step == "crash":
            simulation.crash()
        else:
            simulation.exchange(step != "lose query", step != "lose answer")
        assert len(simulation.stored) == len(set(simulation.stored)), "counted twice"
        assert simulation.stored == sorted(simulation.stored), "out of order"
        assert simulation.acknowledged <= set(simulation.stored), "acknowledged and lost"
    # In the end everything that is held arrives: no state of the two is a deadlock. One more chunk tells
    # the learner what it misses.
    for _ in range(20):
        simulation.exchange(True, True)
    simulation.produce()
    for _ in range(20):
        simulation.exchange(True, True)
    assert simulation.window.is_empty
    produced = set(range(simulation.window.statistics().produced))
    assert produced - set(simulation.stored) == simulation.lost, "lost and not counted"


def _any_chunk() -> Chunk:
    zeros = np.zeros((1, 1), np.float32)
    return Chunk(
        actor="a",
        incarnation=1,
        sequence=0,
        environment=0,
        episode_seed=0,
        first_step=0,
        length=1,
        state_interval=1,
        images=np.zeros((2, 1, 1, 1), np.uint8),
        motion=np.zeros((2, 1), np.float32),
        levels={"intention": LevelColumns(zeros, zeros[0], zeros)},
        policy_version=np.zeros(1, np.int64),
        terminated=False,
        truncated=False,
    )
