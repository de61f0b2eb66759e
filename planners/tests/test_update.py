"""What an update learns from, and what it must not look at."""

import io
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from athrl_planners import AtHRL, PolicyExporter, Sequence, SequenceBatch

MakeAgent = Callable[..., AtHRL]
MakeSequence = Callable[..., Sequence]
Stack = Callable[[list[Sequence]], SequenceBatch]


def flatten(state: Any) -> list[torch.Tensor]:
    """All tensors of a state dict, in order."""
    if isinstance(state, torch.Tensor):
        return [state.clone()]
    if isinstance(state, dict):
        state = list(state.values())
    return [tensor for part in state for tensor in flatten(part)] if isinstance(state, (list, tuple)) else []


def gradients(state: dict[str, Any]) -> list[torch.Tensor]:
    """A tenth of all gradients of the first update: the first moments of the optimisers."""
    optimisers = [part for level in state["levels"].values() for part in level.values() if "state" in part]
    assert optimisers
    return [moments["exp_avg"] for part in optimisers for moments in part["state"].values()]


def equal(one: Any, other: Any) -> bool:
    ours, theirs = flatten(one), flatten(other)
    return len(ours) == len(theirs) and all(map(torch.equal, ours, theirs))


@pytest.fixture
def after(make_agent: MakeAgent) -> Callable[..., dict[str, Any]]:
    """The state of a fresh agent after updates with one batch."""

    def train(batch: SequenceBatch, updates: int = 2, weights: Any = None, **changes: Any) -> dict[str, Any]:
        agent = make_agent(**changes)
        for _ in range(updates):
            agent.update(batch, weights)
        return agent.state_dict()

    return train


def test_padding_never_changes_an_update(make_sequence: MakeSequence, stack: Stack, after: Any) -> None:
    clean = [make_sequence(1, length=3), make_sequence(2, length=5), make_sequence(3, length=1, start=True)]
    dirty = stack(clean)
    for row, length in enumerate(dirty.length):
        dirty.images[row, length + 1 :] = 255
        dirty.motion[row, length + 1 :] = np.nan
        for column in (*dirty.actions.values(), *dirty.rewards.values()):
            column[row, length:] = np.nan
    assert equal(after(stack(clean)), after(dirty))


def test_a_padded_sequence_trains_like_one_without_padding(
    make_sequence: MakeSequence, stack: Stack, after: Any
) -> None:
    padded = make_sequence(1, length=3)
    short = replace(
        padded,
        images=padded.images[:4],
        motion=padded.motion[:4],
        actions={level: column[:3] for level, column in padded.actions.items()},
        rewards={level: column[:3] for level, column in padded.rewards.items()},
    )
    rate = 1e-3
    one, other = (after(stack([each]), updates=1, learning_rate=rate) for each in (padded, short))
    for a, b in zip(gradients(one), gradients(other), strict=True):
        torch.testing.assert_close(a, b, atol=1e-6, rtol=1e-4)
    for a, b in zip(flatten(one), flatten(other), strict=True):
        # Adam's first step is as long for a gradient of mere rounding as for any other: such weights differ.
        alike = torch.isclose(a, b, atol=1e-5, rtol=1e-4)
        assert (~alike).sum() <= 1e-3 * alike.numel()
        torch.testing.assert_close(a, b, atol=2 * rate, rtol=1e-4)


def test_a_sequence_never_learns_from_its_neighbour_in_the_batch(
    make_sequence: MakeSequence, stack: Stack, after: Any
) -> None:
    weights = np.float32([1, 0])
    one = after(stack([make_sequence(1), make_sequence(2)]), weights=weights)
    other = after(stack([make_sequence(1), make_sequence(3)]), weights=weights)
    assert equal(one, other)


def test_what_follows_a_true_end_is_never_looked_at(
    make_sequence: MakeSequence, stack: Stack, after: Any
) -> None:
    ended = make_sequence(1, length=4, terminated=True)
    changed = replace(ended, images=ended.images.copy())
    changed.images[4] = 255
    assert equal(after(stack([ended])), after(stack([changed])))


def test_a_time_limit_is_not_an_end(make_sequence: MakeSequence, stack: Stack, after: Any) -> None:
    cut = make_sequence(1, length=4, terminated=False)
    changed = replace(cut, images=cut.images.copy())
    changed.images[4] = 255
    assert not equal(after(stack([cut])), after(stack([changed])))


@pytest.mark.parametrize(
    ("length", "start", "trained"), [(5, False, False), (5, True, True), (2, False, False), (1, False, True)]
)
def test_burn_in_spares_the_first_decisions_but_no_start_and_no_last_one(
    make_sequence: MakeSequence, stack: Stack, after: Any, length: int, start: bool, trained: bool
) -> None:
    sequence = make_sequence(1, length=length, start=start, terminated=True)
    changed = replace(sequence, rewards={level: r.copy() for level, r in sequence.rewards.items()})
    for rewards in changed.rewards.values():
        rewards[0] += 50
    assert equal(after(stack([sequence])), after(stack([changed]))) is not trained


def test_the_last_decision_of_a_short_rest_is_trained(
    make_sequence: MakeSequence, stack: Stack, after: Any
) -> None:
    crash = make_sequence(1, length=2, terminated=True)
    changed = replace(crash, rewards={level: r.copy() for level, r in crash.rewards.items()})
    for rewards in changed.rewards.values():
        rewards[1] -= 200
    assert not equal(after(stack([crash])), after(stack([changed])))


def test_both_td_errors_reach_the_intention_actor(
    make_agent: MakeAgent, make_sequence: MakeSequence, stack: Stack
) -> None:
    batch = stack([make_sequence(seed) for seed in range(4)])

    def intention_gradient(weight: float) -> float:
        agent = make_agent(intention_gradient=weight, saturation_penalty=0.0, actor_delay=1)
        _blind_to_actions(agent)
        return agent.update(batch)["intention/actor_gradient"]

    assert intention_gradient(0.0) < 1e-12
    assert intention_gradient(1.0) > 1e-7
    assert intention_gradient(2.0) == pytest.approx(2 * intention_gradient(1.0), rel=1e-3)


def _blind_to_actions(agent: AtHRL) -> None:
    """Make the high level's critics say 0 whatever is decided, and keep them so."""
    with torch.no_grad():
        for critic in agent._high.online.critics:
            critic.layers[-1].weight.zero_()
            critic.layers[-1].bias.zero_()
            for parameter in critic.parameters():
                parameter.requires_grad_(False)
    agent._high.step_critics = lambda: 0.0  # type: ignore[method-assign]


def test_the_joint_gradient_changes_the_intention_actor_only(
    make_sequence: MakeSequence, stack: Stack, after: Any
) -> None:
    batch = stack([make_sequence(seed) for seed in range(4)])
    alone = after(batch, updates=1, intention_gradient=0.0, actor_delay=1)["levels"]
    joint = after(batch, updates=1, intention_gradient=1.0, actor_delay=1)["levels"]
    assert equal(alone["trajectory"], joint["trajectory"])
    assert not equal(alone["intention"]["online"], joint["intention"]["online"])


def test_each_level_learns_from_its_own_reward(make_sequence: MakeSequence, stack: Stack, after: Any) -> None:
    batch = stack([make_sequence(seed) for seed in range(4)])
    other = replace(batch, rewards={**batch.rewards, "intention": batch.rewards["intention"] + 30})
    one, two = after(batch, updates=1)["levels"], after(other, updates=1)["levels"]
    assert equal(one["trajectory"], two["trajectory"])
    assert not equal(one["intention"], two["intention"])


def test_training_starts_from_each_levels_own_stored_state(
    make_sequence: MakeSequence, stack: Stack, after: Any
) -> None:
    batch = stack([make_sequence(seed) for seed in range(4)])
    states = {**batch.initial_state, "trajectory": batch.initial_state["trajectory"] + 0.3}
    other = replace(batch, initial_state=states)
    one, two = (
        after(data, updates=1, actor_delay=1, intention_gradient=0.0)["levels"] for data in (batch, other)
    )
    assert equal(one["intention"], two["intention"])
    assert not equal(one["trajectory"], two["trajectory"])


def test_actors_never_change_the_trunk(make_sequence: MakeSequence, stack: Stack, after: Any) -> None:
    batch = stack([make_sequence(seed) for seed in range(4)])
    with_actors = after(batch, updates=1, actor_delay=1)["levels"]
    without = after(batch, updates=1, actor_delay=9)["levels"]
    for level in ("intention", "trajectory"):
        assert equal(
            with_actors[level]["target"]["trunk.lstm.weight_hh_l0"],
            without[level]["target"]["trunk.lstm.weight_hh_l0"],
        )
        assert equal(with_actors[level]["critic_optimiser"], without[level]["critic_optimiser"])
        assert not equal(with_actors[level]["actor_optimiser"], without[level]["actor_optimiser"])


def test_a_saturated_actor_comes_back(
    make_agent: MakeAgent, make_sequence: MakeSequence, stack: Stack
) -> None:
    batch = stack([make_sequence(seed) for seed in range(4)])

    def saturated_after_training(penalty: float) -> float:
        agent = make_agent(saturation_penalty=penalty, actor_delay=1, learning_rate=3e-2)
        with torch.no_grad():
            for level in (agent._high, agent._mid):
                level.online.actor.layers[-1].bias.fill_(12.0)  # there the tanh's gradient is 0 in float32
        return [agent.update(batch)["trajectory/saturated"] for _ in range(60)][-1]

    assert saturated_after_training(0.0) == 1
    assert saturated_after_training(0.02) < 0.5


def test_the_papers_own_recipe_trains(
    make_agent: MakeAgent, make_sequence: MakeSequence, stack: Stack
) -> None:
    agent = make_agent(
        twin_critics=False,
        actor_delay=1,
        target_noise=0.0,
        saturation_penalty=0.0,
        reward_scale=1.0,
        average_decay=0.0,
        burn_in=0,
    )
    metrics = agent.update(stack([make_sequence(seed) for seed in range(4)]))
    assert all(np.isfinite(value) for value in metrics.values())
    for level in (agent._high, agent._mid):  # an average that forgets everything is the newest
        assert equal(level.averaged_actor.state_dict(), level.online.actor.state_dict())


def test_resumed_training_is_the_same_bit_for_bit(
    make_agent: MakeAgent, make_sequence: MakeSequence, stack: Stack
) -> None:
    batches = [stack([make_sequence(10 * number + row) for row in range(3)]) for number in range(6)]
    straight, first, second = make_agent(seed=1), make_agent(seed=1), make_agent(seed=2)
    for batch in batches:
        straight.update(batch)
    for batch in batches[:3]:
        first.update(batch)
    file = io.BytesIO()
    torch.save(first.state_dict(), file)
    file.seek(0)
    second.load_state_dict(torch.load(file, weights_only=True))
    for batch in batches[3:]:
        second.update(batch)
    assert second.updates == straight.updates == 6
    assert equal(second.state_dict(), straight.state_dict())
    assert PolicyExporter(second).artefact() == PolicyExporter(straight).artefact()


def test_a_state_of_another_size_is_refused(make_agent: MakeAgent) -> None:
    with pytest.raises(RuntimeError, match="size mismatch"):
        make_agent(hidden_features=16).load_state_dict(make_agent().state_dict())


def test_a_state_of_another_planner_is_refused(make_agent: MakeAgent) -> None:
    state = {**make_agent().state_dict(), "kind": "h-dqn"}
    with pytest.raises(ValueError, match="h-dqn"):
        make_agent().load_state_dict(state)


def test_the_callers_random_numbers_are_left_alone(make_agent: MakeAgent) -> None:
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    make_agent()
    assert torch.equal(torch.rand(1), expected)


def test_state_of_another_kind_of_device_goes_on_with_noise_of_its_own(
    make_sequence: MakeSequence, stack: Stack, make_agent: MakeAgent
) -> None:
    batch = stack([make_sequence(seed) for seed in range(3)])
    agent = make_agent()
    agent.update(batch)
    state = {**agent.state_dict(), "noise": torch.zeros(16, dtype=torch.uint8)}  # as a GPU's generator has it
    first, second = make_agent(), make_agent()
    for successor in (first, second):
        successor.load_state_dict(state)
        successor.update(batch)
    assert first.updates == 2
    assert equal(first.state_dict(), second.state_dict())
    assert not equal(first.state_dict()["noise"], make_agent().state_dict()["noise"])
