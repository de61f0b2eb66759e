"""What an update learns from, and what it must not look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from athrl_planners import Agent, Sequence, SequenceBatch, SequenceReplay, TrainingDiverged
from athrl_planners.networks import as_pixels

MEMORY = {"memory": "lstm"}
NewAgent = Callable[..., Agent]
NewSequence = Callable[..., Sequence]
Stack = Callable[..., SequenceBatch]
After = Callable[..., dict[str, Any]]


def flatten(state: Any) -> list[torch.Tensor]:
    """All tensors of a state dict, in order."""
    if isinstance(state, torch.Tensor):
        return [state.clone()]
    if isinstance(state, dict):
        state = list(state.values())
    return [tensor for part in state for tensor in flatten(part)] if isinstance(state, (list, tuple)) else []


def equal(one: Any, other: Any) -> bool:
    ours, theirs = flatten(one), flatten(other)
    return len(ours) == len(theirs) > 0 and all(map(torch.equal, ours, theirs))


def part(state: dict[str, Any], *begins: str) -> list[torch.Tensor]:
    """The networks whose names begin like one of these."""
    found = [tensor for name, tensor in state["networks"].items() if name.startswith(begins)]
    assert found
    return found


@pytest.fixture
def after(new_agent: NewAgent) -> After:
    """The state of a fresh agent after updates with one batch."""

    def train(batch: SequenceBatch, updates: int = 2, kind: str = "athrl", **changes: Any) -> dict[str, Any]:
        agent = new_agent(kind, **{**MEMORY, **changes})
        for _ in range(updates):
            agent.update(batch)
        return agent.state_dict()

    return train


@pytest.fixture
def remembering(new_agent: NewAgent, new_sequence: NewSequence) -> Callable[..., Sequence]:
    """A sequence of a planner with a memory."""
    agent = new_agent(**MEMORY)
    return lambda *arguments, **keywords: new_sequence(agent, *arguments, **keywords)


@pytest.mark.parametrize("n_step", [1, 3])
def test_padding_never_changes_an_update(
    remembering: NewSequence, stack: Stack, after: After, n_step: int
) -> None:
    clean = [remembering(1, length=3), remembering(2, length=5), remembering(3, length=1, start=True)]
    dirty = stack(clean)
    for row, length in enumerate(dirty.length):
        dirty.images[row, length + 1 :] = 255
        dirty.motion[row, length + 1 :] = np.nan
        for column in (*dirty.actions.values(), *dirty.rewards.values()):
            column[row, length:] = np.nan
    assert equal(after(stack(clean), n_step=n_step), after(dirty, n_step=n_step))


@pytest.mark.parametrize("kind", ["athrl", "hdqn"])
def test_padding_is_never_drawn_nor_looked_at_without_a_memory(
    new_agent: NewAgent, new_sequence: NewSequence, replay_of: Callable[..., SequenceReplay], kind: str
) -> None:
    one, other = new_agent(kind), new_agent(kind)
    clean = [new_sequence(one, seed, length=length) for seed, length in enumerate((1, 3, 5))]
    dirty = [new_sequence(one, seed, length=length) for seed, length in enumerate((1, 3, 5))]
    for sequence in dirty:
        sequence.images[sequence.length + 1 :] = 255
        sequence.motion[sequence.length + 1 :] = np.nan
        for column in (*sequence.actions.values(), *sequence.rewards.values()):
            column[sequence.length :] = np.nan
    for agent, sequences in ((one, clean), (other, dirty)):
        replay = replay_of(agent, sequences)
        for _ in range(2):
            agent.update(replay.sample(16))
    assert equal(one.state_dict(), other.state_dict())


def test_padded_sequence_trains_like_one_without_padding(
    new_agent: NewAgent, remembering: NewSequence, stack: Stack
) -> None:
    padded = remembering(1, length=3)
    short = replace(
        padded,
        images=padded.images[:4],
        motion=padded.motion[:4],
        actions={level: column[:3] for level, column in padded.actions.items()},
        rewards={level: column[:3] for level, column in padded.rewards.items()},
    )
    moments = []
    for sequence in (padded, short):
        agent = new_agent(**MEMORY)
        agent.update(stack([sequence]))
        moments.append(agent.state_dict()["critic_optimiser"]["state"])
    for place in moments[0]:
        for name in ("exp_avg", "exp_avg_sq"):
            torch.testing.assert_close(moments[0][place][name], moments[1][place][name], atol=1e-6, rtol=1e-4)


def test_sequence_never_learns_from_its_neighbour_in_the_batch(
    remembering: NewSequence, stack: Stack, after: After
) -> None:
    one = after(stack([remembering(1), remembering(2)], weights=[1, 0]))
    other = after(stack([remembering(1), remembering(3)], weights=[1, 0]))
    assert equal(one, other)


def test_what_follows_a_true_end_is_never_looked_at(
    remembering: NewSequence, stack: Stack, after: After
) -> None:
    ended = remembering(1, length=4, terminated=True)
    changed = replace(ended, images=ended.images.copy())
    changed.images[4] = 255
    # A distribution that is moved to one point sums up to 1 only within rounding: see test_values.py.
    assert equal(after(stack([ended]), critic="scalar"), after(stack([changed]), critic="scalar"))


def test_time_limit_is_not_an_end(remembering: NewSequence, stack: Stack, after: After) -> None:
    cut = remembering(1, length=4, terminated=False)
    changed = replace(cut, images=cut.images.copy())
    changed.images[4] = 255
    assert not equal(after(stack([cut])), after(stack([changed])))


@pytest.mark.parametrize(
    ("length", "start", "trained"), [(5, False, False), (5, True, True), (2, False, False), (1, False, True)]
)
def test_burn_in_spares_the_first_decisions_but_no_start_and_no_last_one(
    remembering: NewSequence, stack: Stack, after: After, length: int, start: bool, trained: bool
) -> None:
    sequence = remembering(1, length=length, start=start, terminated=True)
    changed = replace(sequence, rewards={level: r.copy() for level, r in sequence.rewards.items()})
    for rewards in changed.rewards.values():
        rewards[0] += 50
    one, other = (after(stack([each]), burn_in=2) for each in (sequence, changed))
    assert equal(one, other) is not trained


@pytest.mark.parametrize("constant_shapes", [False, True])
def test_burn_in_trains_as_if_the_state_after_it_had_been_stored(
    new_agent: NewAgent, new_sequence: NewSequence, stack: Stack, constant_shapes: bool
) -> None:
    """No gradient passes through it, neither to the encoder nor to the memory (R2D2)."""
    kind, burn_in = "hddpg", 2
    agents = [new_agent(kind, **MEMORY, burn_in=steps) for steps in (burn_in, 0)]
    for agent in agents:
        agent.prepare._constant_shapes = constant_shapes
    whole = new_sequence(agents[0], 1, terminated=True)
    (level,) = whole.actions
    trunk = dict(agents[0].state.target_trunks)[agents[0].state.trunk_of(level)]
    with torch.no_grad():
        state = torch.from_numpy(whole.initial_state[level])[None]
        images, motion = torch.from_numpy(whole.images[:burn_in]), torch.from_numpy(whole.motion[:burn_in])
        features = trunk.features(as_pixels(images), motion)
        _, reached = trunk.unroll(features[:, None], state[:, : trunk.state_size])
    rest = replace(
        whole,
        images=whole.images[burn_in:],
        motion=whole.motion[burn_in:],
        actions={level: whole.actions[level][burn_in:]},
        rewards={level: whole.rewards[level][burn_in:]},
        initial_state={level: reached[0].numpy()},
        length=whole.length - burn_in,
    )
    moments = []
    for agent, sequence in zip(agents, (whole, rest), strict=True):
        agent.update(stack([sequence]))
        moments.append(agent.state_dict()["critic_optimiser"]["state"])
    for place in moments[0]:
        torch.testing.assert_close(
            moments[0][place]["exp_avg"], moments[1][place]["exp_avg"], atol=1e-6, rtol=1e-4
        )


def test_last_decision_of_a_short_rest_is_trained(
    remembering: NewSequence, stack: Stack, after: After
) -> None:
    crash = remembering(1, length=2, terminated=True)
    changed = replace(crash, rewards={level: r.copy() for level, r in crash.rewards.items()})
    for rewards in changed.rewards.values():
        rewards[1] -= 200
    assert not equal(after(stack([crash]), burn_in=2), after(stack([changed]), burn_in=2))


def test_training_starts_from_each_levels_own_stored_state(
    new_agent: NewAgent, new_sequence: NewSequence, stack: Stack, after: After
) -> None:
    alone = {
        "shared_trunk": False,
        "intention_gradient": 0.0,
        "intention_target": "experience",
        "td3_actor_delay": 1,
    }
    agent = new_agent(**MEMORY, **alone)
    batch = stack([new_sequence(agent, seed) for seed in range(4)])
    states = {**batch.initial_state, "trajectory": batch.initial_state["trajectory"] + np.float32(0.3)}
    one, two = (after(data, **alone) for data in (batch, replace(batch, initial_state=states)))
    assert equal(part(one, "trunks.intention"), part(two, "trunks.intention"))
    assert not equal(part(one, "trunks.trajectory"), part(two, "trunks.trajectory"))


def test_each_level_learns_from_its_own_reward(
    new_agent: NewAgent, new_sequence: NewSequence, stack: Stack, after: After
) -> None:
    own = {"shared_trunk": False, "intention_target": "experience"}
    agent = new_agent(**MEMORY, **own)
    batch = stack([new_sequence(agent, seed) for seed in range(4)])
    other = replace(batch, rewards={**batch.rewards, "intention": batch.rewards["intention"] + 30})
    # A norm that nothing reaches: all critics share one, so one's gradients would scale the other's.
    one, two = (after(each, updates=1, gradient_norm=1e9, **own) for each in (batch, other))
    mine, yours = ("trunks.trajectory", "levels.trajectory"), ("trunks.intention", "levels.intention")
    assert equal(part(one, *mine), part(two, *mine))
    assert not equal(part(one, *yours), part(two, *yours))


def test_actors_never_change_the_trunk(remembering: NewSequence, stack: Stack, after: After) -> None:
    batch = stack([remembering(seed) for seed in range(4)])
    with_actors = after(batch, updates=1, td3_actor_delay=1)
    without = after(batch, updates=1, td3_actor_delay=9)
    assert equal(part(with_actors, "trunks", "target_trunks"), part(without, "trunks", "target_trunks"))
    assert equal(with_actors["critic_optimiser"], without["critic_optimiser"])
    for level in ("intention", "trajectory"):
        place = f"levels.{level}.online.actor"
        assert not equal(part(with_actors, place), part(without, place))


def test_saturated_actor_comes_back(new_agent: NewAgent, new_sequence: NewSequence, stack: Stack) -> None:
    def saturated_after_training(penalty: float) -> float:
        agent = new_agent(**MEMORY, saturation_penalty=penalty, td3_actor_delay=1, learning_rate=3e-2)
        with torch.no_grad():
            for level in agent.state.levels:
                level.online.actor.layers.last.bias.fill_(12.0)  # its tanh's gradient is 0 in float32
        batch = stack([new_sequence(agent, seed) for seed in range(4)])
        return float([agent.update(batch)[0]["trajectory/saturated"] for _ in range(60)][-1])

    assert saturated_after_training(0.0) == 1
    assert saturated_after_training(0.02) < 0.5


def test_average_that_forgets_everything_is_the_newest(remembering: NewSequence, new_agent: NewAgent) -> None:
    agent = new_agent("ddpg", average_decay=0.0, td3_actor_delay=1)
    with torch.no_grad():
        agent.state.levels[0].online.actor.layers.last.bias.fill_(1.0)
    agent.state.update_targets()
    for level in agent.state.levels:
        assert equal(level.averaged.state_dict(), level.online.actor.state_dict())


def test_step_sizes_fall_with_the_run(remembering: NewSequence, stack: Stack, new_agent: NewAgent) -> None:
    batch = stack([remembering(seed) for seed in range(4)])
    moved = []
    for progress in (0.0, 0.5, 1.0):
        agent = new_agent(**MEMORY, learning_rate=1e-2, final_learning_rate=0.1)
        before = part(agent.state_dict(), "trunks.intention.dense.0.weight")[0].clone()
        agent.update(batch, progress)
        moved.append(
            float((part(agent.state_dict(), "trunks.intention.dense.0.weight")[0] - before).abs().mean())
        )
    assert moved[1] == pytest.approx(0.55 * moved[0], rel=1e-2)
    assert moved[2] == pytest.approx(0.1 * moved[0], rel=1e-2)


@pytest.mark.parametrize("critic", ["scalar", "distributional"])
def test_loss_that_is_no_number_changes_no_network(
    new_agent: NewAgent, remembering: NewSequence, stack: Stack, critic: str
) -> None:
    agent = new_agent(**MEMORY, critic=critic)
    before = [tensor.clone() for tensor in agent.state_dict()["networks"].values()]
    batch = stack([remembering(seed) for seed in range(2)])
    batch.rewards["trajectory"][0, 0] = np.nan
    with pytest.raises(TrainingDiverged, match="the loss of update 1 is"):
        agent.update(batch)
    assert equal(before, list(agent.state_dict()["networks"].values()))
    assert agent.updates == 0


def test_callers_random_numbers_are_left_alone(new_agent: NewAgent) -> None:
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    new_agent()
    assert torch.equal(torch.rand(1), expected)


def test_equal_seeds_give_equal_agents(new_agent: NewAgent) -> None:
    for kind in ("athrl", "hdqn"):
        one, other, third = (new_agent(kind, seed=seed) for seed in (3, 3, 4))
        assert equal(one.state_dict(), other.state_dict())
        assert not equal(one.state_dict()["networks"], third.state_dict()["networks"])
