"""What an actor knows of the warm-up lets it stop near the end, and never for good before it."""

import itertools
from types import SimpleNamespace

from athrl_actor.warm_up import WarmUp
from athrl_protocol import Phase, RunState
from hypothesis import given
from hypothesis import strategies as st


def state(steps: int, needed: int) -> RunState:
    return RunState(Phase.WARMING_UP if steps < needed else Phase.TRAINING, steps, 10_000, 0, 0)


@given(
    told=st.integers(0, 300),
    needed=st.integers(0, 300),
    lost=st.sets(st.integers(0, 20)),
    chunk=st.integers(1, 40),
    every=st.integers(1, 5),
)
def test_a_warm_up_of_any_length_ends_although_chunks_are_lost(
    told: int, needed: int, lost: set[int], chunk: int, every: int
) -> None:
    """`told` is what the run file of the actor says, `needed` what the learner waits for."""
    needed = max(1, needed)
    warm_up, known, accepted = WarmUp(told), state(0, needed), 0
    chunks, driven = itertools.count(), 0
    for round_ in range(2_000):
        if accepted >= needed:
            break
        if not warm_up.is_driven(known, 0):
            number = next(chunks)
            driven += chunk
            warm_up.submitted(SimpleNamespace(length=chunk))
            warm_up.settled(number + 1)
            accepted += 0 if number in lost else chunk
        if round_ % every == 0:
            known = state(accepted, needed)
    assert accepted >= needed
    if not lost and told == needed:
        assert driven < needed + chunk


def test_decisions_are_counted_once_wherever_they_are() -> None:
    warm_up, known = WarmUp(100), state(40, 100)
    for _ in range(2):
        warm_up.submitted(SimpleNamespace(length=20))
    assert warm_up.is_driven(known, 20)
    assert not warm_up.is_driven(known, 19)
    warm_up.settled(1)  # maybe after the state was made: counted until the next one
    assert warm_up.is_driven(known, 20)
    assert not warm_up.is_driven(known, 19)
    later = state(60, 100)
    assert warm_up.is_driven(later, 20)
    assert not warm_up.is_driven(later, 19)
    warm_up.settled(1)
    assert not warm_up.is_driven(later, 19)


def test_without_a_word_of_the_learner_its_own_decisions_are_those_of_the_run() -> None:
    warm_up = WarmUp(10)
    warm_up.submitted(SimpleNamespace(length=8))
    warm_up.settled(1)
    assert not warm_up.is_driven(None, 1)
    assert warm_up.is_driven(None, 2)
