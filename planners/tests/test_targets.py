"""Targets of whole updates, against loops over their definition.

A critic that says the same of everything makes its error tell the target; an update returns the errors.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from athrl_planners import Agent, Sequence, SequenceBatch, SequenceReplay
from athrl_planners.networks import as_pixels
from athrl_planners.training.level import Level

FAR = -500.0
PLAIN = {
    "update_rule": "ddpg",
    "critic": "scalar",
    "critics": 1,
    "reward_scale": 0.1,
    "discount": 0.9,
    "end_penalty": 7.0,
}
HELD = {**PLAIN, "intention_target": "experience"}
NewAgent = Callable[..., Agent]
NewSequence = Callable[..., Sequence]
ReplayOf = Callable[..., SequenceReplay]


def say(level: Level, value: float, networks: str = "online") -> None:
    """Let the level's critics say a value of everything."""
    with torch.no_grad():
        for critic in getattr(level, networks).critics:
            critic.layers.last.weight.zero_()
            critic.layers.last.bias.fill_(value)


def spread(agent: Agent) -> None:
    """Give the target networks weights at which decisions and values differ from frame to frame."""
    with torch.no_grad():
        for level in agent.state.levels:
            networks = [level.target.actor, *level.target.critics]
            for network in networks:
                torch.nn.init.normal_(network.layers.last.weight, std=0.7)


@torch.no_grad()
def contexts_of(agent: Agent, sequence: Sequence, level: str) -> torch.Tensor:
    """What the level's target trunk makes of each frame of a sequence: [time + 1, context]."""
    name = agent.state.trunk_of(level)
    trunk = dict(agent.state.target_trunks)[name]
    features = trunk.features(as_pixels(torch.from_numpy(sequence.images)), torch.from_numpy(sequence.motion))
    state = torch.from_numpy(sequence.initial_state[name])[None]
    return trunk.unroll(features[:, None], state[:, : trunk.state_size])[0][:, 0]


@torch.no_grad()
def decide_and_value(level: Level, context: torch.Tensor, above: torch.Tensor) -> tuple[torch.Tensor, float]:
    """A target actor's decision [n] for one context, normalised, and the target critic's value of it."""
    action = (1.1 * torch.tanh(level.target.actor(context[None], above[None]))).clamp(-1, 1)
    value = level.target.critics[0](context[None], above[None], action)
    return action[0], float(value)


def horizon_target(sequence: Sequence, level: str, step: int, n: int, values: list[float]) -> float:
    """The target of one decision: rewards of n steps, or up to the end, and the value there."""
    steps = min(n, sequence.length - step)
    target = sum(
        PLAIN["discount"] ** k * PLAIN["reward_scale"] * float(sequence.rewards[level][step + k])
        for k in range(steps)
    )
    if sequence.terminated and step + steps == sequence.length:
        return target - PLAIN["discount"] ** (steps - 1) * PLAIN["end_penalty"]
    return target + PLAIN["discount"] ** steps * values[step + steps]


def told_targets(agent: Agent, replay: SequenceReplay, level: int) -> dict[int, float]:
    """Targets of a level by the replay's places, for critics that say FAR; of a sequence the largest."""
    say(agent.state.levels[level], FAR)
    batch = replay.sample(400)
    _, errors = agent.update(batch)
    return {int(place): float(error) + FAR for place, error in zip(batch.places, errors, strict=True)}


@pytest.fixture
def sequences(new_sequence: NewSequence) -> Callable[[Agent], list[Sequence]]:
    """Full ones and short ones, truly ended or cut off by time or by the sequence's length."""

    def make(agent: Agent) -> list[Sequence]:
        shapes = [(5, False), (5, True), (3, True), (2, False), (1, True), (1, False)]
        return [
            new_sequence(agent, seed, length=length, terminated=terminated, start=seed == 2)
            for seed, (length, terminated) in enumerate(shapes)
        ]

    return make


@pytest.mark.parametrize("n_step", [1, 2, 3, 8])
@pytest.mark.parametrize("memory", ["none", "lstm"])
@pytest.mark.parametrize("kind", ["hddpg", "ddpg"])
def test_targets_of_one_level(
    new_agent: NewAgent,
    replay_of: ReplayOf,
    sequences: Callable[[Agent], list[Sequence]],
    n_step: int,
    memory: str,
    kind: str,
) -> None:
    agent = new_agent(kind, n_step=n_step, memory=memory, **PLAIN)
    spread(agent)
    stored, level = sequences(agent), agent.state.levels[0]
    expected = {}
    for slot, sequence in enumerate(stored):
        contexts = contexts_of(agent, sequence, level.name)
        values = [decide_and_value(level, context, torch.zeros(0))[1] for context in contexts]
        targets = [
            horizon_target(sequence, level.name, step, n_step, values) for step in range(sequence.length)
        ]
        if memory == "lstm":
            expected[slot] = max(targets)
        else:
            expected |= {5 * slot + step: target for step, target in enumerate(targets)}
    assert told_targets(agent, replay_of(agent, stored), 0) == pytest.approx(expected, abs=2e-3)


def test_distributional_target_has_the_mean_of_the_scalar_one(
    new_agent: NewAgent, replay_of: ReplayOf, new_sequence: NewSequence
) -> None:
    """Inside the support; here with constant critics in place of values."""
    settings: dict[str, Any] = {**PLAIN, "n_step": 3, "atoms": 51, "value_min": -40, "value_max": 40}
    means = []
    for critic in ("scalar", "distributional"):
        agent = new_agent("hddpg", **{**settings, "critic": critic})
        level = agent.state.levels[0]
        for networks in ("online", "target"):
            say(level, 0.0, networks)
        batch = replay_of(agent, [new_sequence(agent, 1, terminated=True)]).sample(50)
        means.append(agent.update(batch)[1].numpy())
    np.testing.assert_allclose(means[0], means[1], atol=1e-3)


def decides(sequence: Sequence, step: int, every: int) -> bool:
    """Whether the intention is decided at this step, and not held."""
    return (round(float(sequence.initial_state["intention"][-1])) - step) % every == 0


@pytest.mark.parametrize("n_step", [1, 2, 4])
@pytest.mark.parametrize("every", [1, 2, 3])
@pytest.mark.parametrize("shared_trunk", [True, False])
def test_targets_of_the_trajectory_planner_under_a_held_intention(
    new_agent: NewAgent,
    replay_of: ReplayOf,
    sequences: Callable[[Agent], list[Sequence]],
    n_step: int,
    every: int,
    shared_trunk: bool,
) -> None:
    agent = new_agent(n_step=n_step, intention_every=every, shared_trunk=shared_trunk, **HELD)
    spread(agent)
    stored, (high, low) = sequences(agent), agent.state.levels
    expected = {}
    for slot, sequence in enumerate(stored):
        above, below = (contexts_of(agent, sequence, level.name) for level in (high, low))
        values = [0.0]
        for step in range(1, sequence.length + 1):
            if every == 1 or decides(sequence, step, every):
                intention = decide_and_value(high, above[step], torch.zeros(0))[0]
            else:
                intention = torch.from_numpy(sequence.actions["intention"][step - 1]) - 1
            values.append(decide_and_value(low, below[step], intention)[1])
        for step in range(sequence.length):
            expected[5 * slot + step] = horizon_target(sequence, "trajectory", step, n_step, values)
    assert told_targets(agent, replay_of(agent, stored), 1) == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("memory", ["none", "lstm"])
def test_held_intention_is_trained_where_it_is_decided_over_as_long_as_it_is_held(
    new_agent: NewAgent, replay_of: ReplayOf, new_sequence: NewSequence, memory: str
) -> None:
    agent = new_agent(n_step=1, intention_every=3, memory=memory, **HELD)
    sequence = new_sequence(agent, 1, length=5)
    sequence.initial_state["intention"][-1] = 1  # so it is decided at 1 and at 4
    sequence.rewards["intention"][:] = [10, 20, 30, 40, 50]
    batch = replay_of(agent, [sequence]).sample(40)
    data = agent.prepare(batch)
    steps = np.tile(np.arange(5), 8)
    if memory == "lstm":
        assert isinstance(batch, SequenceBatch)
        steps = np.repeat(np.arange(5), 8)  # one step of all sequences after the other
    else:
        steps = batch.places
    level = data.levels["intention"]
    assert (level.weights.numpy() > 0).tolist() == np.isin(steps, (1, 4)).tolist()
    assert float(level.weights.sum()) == pytest.approx(1)
    summed = {1: 2 + 0.9 * 3 + 0.81 * 4, 4: 5.0}
    later = {1: 0.9**3, 4: 0.9}  # cut off by the end of the sequence
    for step in (1, 4):
        np.testing.assert_allclose(level.reward[steps == step], summed[step], rtol=1e-5)
        np.testing.assert_allclose(level.discount[steps == step], later[step], rtol=1e-5)
    every_decision = data.levels["trajectory"]
    np.testing.assert_allclose(every_decision.weights, 1 / len(steps), rtol=1e-5)


def test_target_of_a_held_intention_values_the_one_that_still_holds(
    new_agent: NewAgent, replay_of: ReplayOf, new_sequence: NewSequence
) -> None:
    """At a sequence's end what is held there counts, not what would be decided."""
    agent = new_agent(intention_every=3, **HELD)
    spread(agent)
    sequence = new_sequence(agent, 1, length=2)
    sequence.initial_state["intention"][-1] = 0  # decided at 0, held at 1 and at 2
    say(agent.state.levels[1], 0.0)
    say(agent.state.levels[1], 0.0, "target")
    sequence.rewards["trajectory"][:] = 0
    context = contexts_of(agent, sequence, "intention")[2]
    held = torch.from_numpy(sequence.actions["intention"][1]) - 1
    with torch.no_grad():
        value = float(agent.state.levels[0].target.critics[0](context[None], torch.zeros(1, 0), held[None]))
    rewards = sequence.rewards["intention"]
    expected = 0.1 * (float(rewards[0]) + 0.9 * float(rewards[1])) + 0.81 * value
    told = told_targets(agent, replay_of(agent, [sequence]), 0)
    assert told[0] == pytest.approx(expected, abs=1e-3)


def test_entropy_counts_only_where_an_intention_is_decided(
    new_agent: NewAgent, replay_of: ReplayOf, new_sequence: NewSequence
) -> None:
    """0.1 * (10 + 0.9 * 20) + 0.81 * 2: it is still held after two decisions, so nothing is drawn there."""
    held_by_sac = {**HELD, "update_rule": "sac", "sac_temperature": 100.0}
    agent = new_agent(intention_every=3, **held_by_sac)
    sequence = new_sequence(agent, 1, length=2)
    sequence.initial_state["intention"][-1] = 0  # decided at 0, held at 1 and at 2
    sequence.rewards["intention"][:2] = [10, 20]
    say(agent.state.levels[0], 2.0, "target")
    for networks in ("online", "target"):
        say(agent.state.levels[1], 0.0, networks)
    told = told_targets(agent, replay_of(agent, [sequence]), 0)
    assert told[0] == pytest.approx(2.8 + 0.81 * 2, abs=1e-3)


def test_decisions_that_only_hold_an_intention_have_no_error_of_it(
    new_agent: NewAgent, replay_of: ReplayOf, new_sequence: NewSequence
) -> None:
    """No critic is trained on them, so no priority should follow from what one says of them."""
    agent = new_agent(intention_every=3, **HELD)
    sequence = new_sequence(agent, 1, length=5)
    sequence.initial_state["intention"][-1] = 1  # decided at 1 and at 4
    for rewards in sequence.rewards.values():
        rewards[:] = 0
    for level in agent.state.levels:
        say(level, 0.0, "target")
    say(agent.state.levels[1], 0.0)
    told = told_targets(agent, replay_of(agent, [sequence]), 0)
    errors = {place: target - FAR for place, target in told.items()}
    assert errors == pytest.approx({0: 0, 1: -FAR, 2: 0, 3: 0, 4: -FAR}, abs=1e-3)


def test_end_costs_its_penalty_once_at_the_step_where_it_happens(
    new_agent: NewAgent, replay_of: ReplayOf, new_sequence: NewSequence
) -> None:
    agent = new_agent("hddpg", n_step=3, **PLAIN)
    sequence = new_sequence(agent, 1, length=5, terminated=True)
    sequence.rewards["trajectory"][:] = 0
    batch = replay_of(agent, [sequence]).sample(60)
    reward = agent.prepare(batch).levels["trajectory"].reward
    expected = np.array([0, 0, -7 * 0.81, -7 * 0.9, -7])
    np.testing.assert_allclose(reward, expected[batch.places], atol=1e-6)
