"""Prioritised replay: a sum tree against a slow sum, and what is drawn how often."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from athrl_planners import Agent, Sequence, SequenceReplay
from athrl_planners.factories import make_replay
from athrl_planners.replay.sampling import SMALLEST_PRIORITY, PrioritisedSampler
from athrl_planners.replay.sum_tree import SumTree
from hypothesis import given, settings
from hypothesis import strategies as st

Agents = Callable[..., Agent]
Sequences = Callable[..., Sequence]


class SlowTree:
    """A list of weights; what lies at a share of their sum is found by adding them up."""

    def __init__(self, size: int) -> None:
        self.weights = [0.0] * size

    def find(self, share: float) -> int:
        total = 0.0
        for number, weight in enumerate(self.weights):
            total += weight
            if share < total:
                return number
        raise AssertionError("the share lies behind the sum")


@st.composite
def changes(draw: st.DrawFn) -> tuple[int, list[dict[int, int]]]:
    """The size of a tree, and some rounds of new weights; whole numbers, whose sums are exact."""
    size = draw(st.integers(1, 40))
    leaf, weight = st.integers(0, size - 1), st.integers(0, 50)
    rounds = draw(st.lists(st.dictionaries(leaf, weight, min_size=1), min_size=1, max_size=6))
    return size, rounds


@given(changes())
@settings(max_examples=150, deadline=None)
def test_sum_tree_finds_what_a_slow_sum_finds(case: tuple[int, list[dict[int, int]]]) -> None:
    size, rounds = case
    tree, slow = SumTree(size), SlowTree(size)
    for weights in rounds:
        tree.set(np.array(list(weights)), np.array(list(weights.values()), float))
        for leaf, weight in weights.items():
            slow.weights[leaf] = weight
        assert tree.total == sum(slow.weights)
        np.testing.assert_array_equal(tree.all_weights(), slow.weights)
        shares = np.arange(0, tree.total, 0.5)
        assert tree.find(shares).tolist() == [slow.find(share) for share in shares]


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=30).filter(any), st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_leaf_of_no_weight_is_never_found(weights: list[float], seed: int) -> None:
    """Not even by a share that rounding has brought to the very end of the sum."""
    tree = SumTree(len(weights))
    tree.set(np.arange(len(weights)), np.array(weights))
    shares = np.append(np.random.default_rng(seed).random(50) * tree.total, [0.0, tree.total])
    assert (tree.weights(tree.find(shares)) > 0).all()


def test_of_a_leaf_that_comes_twice_the_last_weight_counts() -> None:
    tree = SumTree(3)
    tree.set(np.array([1, 1, 2]), np.array([5.0, 2.0, 1.0]))
    assert tree.all_weights().tolist() == [0.0, 2.0, 1.0]
    assert tree.total == 3.0


def filled(errors: list[float], exponent: float = 1.0, importance: float = 0.5) -> PrioritisedSampler:
    sampler = PrioritisedSampler(len(errors), exponent, importance)
    places = np.arange(len(errors))
    sampler.put(places, np.ones(len(errors), bool))
    sampler.update_priorities(places, np.float32(errors))
    return sampler


@pytest.mark.parametrize("exponent", [0.0, 0.6, 1.0])
def test_items_are_drawn_in_proportion_to_their_errors(exponent: float) -> None:
    errors = np.array([0.5, 1.0, 2.0, 8.0])
    sampler = filled(list(errors), exponent)
    random = np.random.default_rng(1)
    places = np.concatenate([sampler.draw(64, random)[0] for _ in range(300)])
    expected = (errors + SMALLEST_PRIORITY) ** exponent
    found = np.bincount(places, minlength=4) / len(places)
    np.testing.assert_allclose(found, expected / expected.sum(), atol=0.01)


@pytest.mark.parametrize("importance", [0.0, 0.4, 1.0])
def test_importance_weighs_against_being_drawn_more_often(importance: float) -> None:
    errors = np.array([0.5, 1.0, 2.0, 8.0])
    places, weights = filled(list(errors), 1.0, importance).draw(200, np.random.default_rng(1))
    assert weights.dtype == np.float32
    priorities = errors + SMALLEST_PRIORITY
    expected = (priorities[0] / priorities[places]) ** importance
    np.testing.assert_allclose(weights, expected, rtol=1e-5)
    if importance == 1:  # then each item counts as often as with uniform sampling
        counted = np.bincount(places, weights=weights)
        np.testing.assert_allclose(counted / counted.sum(), 0.25, atol=0.02)


def test_draws_are_spread_over_the_whole_sum() -> None:
    """One in each of equal parts: of equal priorities none comes twice before all came once."""
    places, _ = filled([1.0] * 16).draw(16, np.random.default_rng(1))
    assert sorted(places) == list(range(16))


def test_what_is_new_has_the_highest_priority_so_far() -> None:
    sampler = filled([3.0, 0.5, 0.5, 0.5])
    sampler.put(np.array([2]), np.ones(1, bool))
    priorities = sampler.state()["priorities"]
    assert priorities[2] == priorities[0] == pytest.approx(3 + SMALLEST_PRIORITY)
    assert priorities[1] == pytest.approx(0.5 + SMALLEST_PRIORITY)


def test_what_is_not_stored_gets_no_priority() -> None:
    sampler = filled([1.0, 1.0])
    sampler.put(np.array([1]), np.zeros(1, bool))
    sampler.update_priorities(np.array([0, 1]), np.float32([2, 2]))
    assert sampler.state()["priorities"][1] == 0


@pytest.fixture(params=["none", "lstm"])
def agent(request: pytest.FixtureRequest, new_agent: Agents) -> Agent:
    return new_agent(memory=request.param)


def prioritised(agent: Agent, slots: int = 4, seed: int = 1) -> SequenceReplay:
    return make_replay(agent, 5 * slots, 5, seed, (0.6, 0.4))


def test_error_of_what_was_replaced_meanwhile_is_not_the_new_ones(
    agent: Agent, new_sequence: Sequences
) -> None:
    replay = prioritised(agent, slots=2)
    for seed in range(2):
        replay.insert(new_sequence(agent, seed))
    batch = replay.sample(200)
    replay.insert(new_sequence(agent, 7))  # in place of the first, before the errors are known
    replay.update_priorities(batch, np.full(len(batch.places), 8.0, np.float32))
    priorities = replay.priorities()["priorities"]
    new, kept = np.split(priorities, 2)
    assert new == pytest.approx(1.0)  # what every new item gets
    assert kept == pytest.approx((8.0 + SMALLEST_PRIORITY) ** 0.6)


def test_what_is_overwritten_is_gone(agent: Agent, new_sequence: Sequences) -> None:
    """A full sequence makes room for one with padding, whose places have large errors from before."""
    replay = prioritised(agent, slots=2)
    for seed in range(2):
        replay.insert(new_sequence(agent, seed))
    batch = replay.sample(200)
    replay.update_priorities(batch, np.full(len(batch.places), 1e4, np.float32))
    replay.insert(new_sequence(agent, 7, length=1))
    drawn = replay.sample(400)
    first = drawn.places // (1 if agent.has_memory else 5) == 0
    assert first.any()
    steps = drawn.length[first] if agent.has_memory else 1 + drawn.step[first]
    assert (steps == 1).all()
    expected = new_sequence(agent, 7, length=1).images[0]
    seen = drawn.images[:, 0] if agent.has_memory else drawn.images[0]
    assert (seen[first] == expected).all()


def test_items_with_large_errors_are_found_often(agent: Agent, new_sequence: Sequences) -> None:
    """As the few true ends among many decisions that were foreseen."""
    replay = prioritised(agent, slots=40)
    for seed in range(40):
        replay.insert(new_sequence(agent, seed, terminated=seed == 13))
    for _ in range(40):
        batch = replay.sample(100)
        ends = batch.terminated if agent.has_memory else batch.terminated[0] & (batch.step == 4)
        replay.update_priorities(batch, np.where(ends, 16.0, 0.01).astype(np.float32))
    batch = replay.sample(1000)
    ends = batch.terminated if agent.has_memory else batch.terminated[0] & (batch.step == 4)
    items = 40 if agent.has_memory else 200
    assert ends.mean() > 10 / items
    assert batch.weights[ends].max() < batch.weights[~ends].min()


def test_restored_replay_draws_the_same(agent: Agent, new_sequence: Sequences) -> None:
    replay = prioritised(agent)
    sequences = [new_sequence(agent, seed, length=1 + seed % 5) for seed in range(6)]
    for sequence in sequences:
        replay.insert(sequence)
    random = np.random.default_rng(3)
    batch = replay.sample(50)
    replay.update_priorities(batch, random.random(len(batch.places)).astype(np.float32))
    restored = prioritised(agent, seed=9)
    restored.load_state(replay.state(), sequences[-4:])
    restored.load_priorities(replay.priorities())
    for both in (replay, restored):
        both.insert(new_sequence(agent, 50))
    for _ in range(3):
        one, other = replay.sample(50), restored.sample(50)
        np.testing.assert_equal(vars(other), vars(one))
        errors = random.random(len(one.places)).astype(np.float32)
        replay.update_priorities(one, errors)
        restored.update_priorities(other, errors)


def test_priorities_of_another_replay_leave_everything_to_be_drawn(
    agent: Agent, new_sequence: Sequences
) -> None:
    """Some sequences were damaged: others lie where there was nothing."""
    few, many = prioritised(agent), prioritised(agent)
    few.insert(new_sequence(agent, 1, length=1))
    for seed in range(4):
        many.insert(new_sequence(agent, seed))
    many.load_priorities(few.priorities())
    assert len(set(many.sample(400).places)) == (4 if agent.has_memory else 20)


def test_priorities_of_a_replay_of_another_size_are_refused(agent: Agent) -> None:
    with pytest.raises(ValueError, match=r"it has \d+ priorities, the replay has room for \d+"):
        prioritised(agent).load_priorities(prioritised(agent, slots=5).priorities())


def test_even_replay_ignores_errors_and_priorities(agent: Agent, new_sequence: Sequences) -> None:
    replay = make_replay(agent, 20, 5, seed=1)
    replay.insert(new_sequence(agent, 1))
    batch = replay.sample(10)
    replay.update_priorities(batch, np.full(len(batch.places), 9.0, np.float32))
    assert replay.priorities() == {}
    replay.load_priorities(prioritised(agent).priorities())
    assert (replay.sample(10).weights == 1).all()


def test_importance_reaches_the_loss(new_agent: Agents, new_sequence: Sequences) -> None:
    agent = new_agent("hddpg")
    replay = prioritised(agent)
    replay.insert(new_sequence(agent, 1))
    batch = replay.sample(5)
    replay.update_priorities(batch, np.float32([8, 1, 1, 1, 1]))
    batch = replay.sample(20)
    weights = agent.prepare(batch).levels["trajectory"].weights.numpy()
    np.testing.assert_allclose(weights, batch.weights / batch.weights.sum(), rtol=1e-5)
    assert weights.min() < 0.7 * weights.max()
