"""Defects of the authors' release that these planners must not have (`shared/paper/FACTS.md`, the list).

Those of the controllers and units (3, 4, 5) are tested with the environments, the counting of steps (9) with
the learner.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from athrl_planners import Agent, PolicyExporter, Sequence, SequenceBatch, SequenceReplay
from athrl_spaces import Noise

Arrays = dict[str, np.ndarray]
Decide = Callable[..., Arrays]
BATCH = 4
MEMORY = {"memory": "lstm", "shared_trunk": False}


@pytest.fixture
def trained(
    new_agent: Callable[..., Agent],
    new_sequence: Callable[..., Sequence],
    replay_of: Callable[..., SequenceReplay],
) -> Callable[..., Agent]:
    """An atHRL that has left its beginnings, where all actions are in the middle."""

    def make(**settings: Any) -> Agent:
        agent = new_agent(learning_rate=1e-2, average_decay=0.2, td3_actor_delay=1, **settings)
        replay = replay_of(agent, [new_sequence(agent, seed) for seed in range(4)])
        for _ in range(15):
            agent.update(replay.sample(20))
        return agent

    return make


def seen(agent: Agent) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    shape = (BATCH, *agent.description.observation.image_shape)
    return random.integers(0, 256, shape, dtype=np.uint8), np.zeros((BATCH, 2), np.float32)


def through_network(agent: Agent) -> Decide:
    """Decide with the torch network; keywords are what its levels are forced to."""

    def decide(**forced: float) -> Arrays:
        states = {
            level.name: np.zeros((BATCH, level.state_size), np.float32) for level in agent.description.levels
        }
        given = {name: np.full((BATCH, 1), value, np.float32) for name, value in forced.items()}
        return agent.act(*seen(agent), states, None, given).actions

    return decide


def through_artefact(agent: Agent) -> Decide:
    """The same by the artefact."""
    session = onnxruntime.InferenceSession(
        PolicyExporter(agent).artefact(), providers=["CPUExecutionProvider"]
    )

    def decide(**forced: float) -> Arrays:
        images, motion = seen(agent)
        inputs: Arrays = {"image": images, "motion": motion}
        for level in agent.description.levels:
            shape = (BATCH, level.action_size)
            inputs[f"{level.name}_noise"] = np.zeros(shape, np.float32)
            inputs[f"forced_{level.name}"] = np.full(shape, forced.get(level.name, np.nan), np.float32)
            if level.state_size:
                inputs[f"{level.name}_state"] = np.zeros((BATCH, level.state_size), np.float32)
        names = [output.name for output in session.get_outputs()]
        return dict(zip(names, session.run(names, inputs), strict=True))

    return decide


@pytest.fixture(params=["network", "artefact"])
def decide(request: pytest.FixtureRequest, trained: Callable[..., Agent]) -> Decide:
    """Decisions of a trained atHRL by either way."""
    return (through_network if request.param == "network" else through_artefact)(trained())


def test_defect_1_intention_never_reaches_the_trajectory_planner(decide: Decide) -> None:
    left, right = decide(intention=0.0)["trajectory"], decide(intention=2.0)["trajectory"]
    assert (np.abs(left - right) > 1e-4).all()


def test_defect_1_trajectory_critic_never_sees_the_intention(trained: Callable[..., Agent]) -> None:
    level = trained().state.levels[1]
    context = torch.zeros(1, level.rule.context_size)
    action = torch.zeros(1, 2)
    left, right = (
        level.rule.value_of(level.online.critics[0], context, torch.tensor([[intention]]), action)
        for intention in (-1.0, 1.0)
    )
    assert not torch.allclose(left, right, atol=1e-5)


def test_defect_2_intention_is_cast_to_an_integer(decide: Decide) -> None:
    decided = {value: decide(intention=value) for value in (1.0, 1.4, 1.5, 1.6, 2.0)}
    for value, actions in decided.items():
        np.testing.assert_allclose(actions["intention"], value, rtol=1e-6)
    trajectories = np.stack([actions["trajectory"] for actions in decided.values()])
    for row in range(BATCH):
        assert len({tuple(each) for each in trajectories[:, row]}) == 5


def test_defect_2_intention_is_trained_on_as_an_integer(new_agent: Callable[..., Agent]) -> None:
    rule = new_agent().state.levels[0].rule
    np.testing.assert_allclose(rule.encode(torch.tensor([[0.0], [0.7], [1.5]])), [[-1], [-0.3], [0.5]])


@pytest.mark.parametrize("carried", ["intention", "trajectory"])
def test_defect_6_recurrent_state_is_reset_or_shared_between_levels(
    trained: Callable[..., Agent], carried: str
) -> None:
    agent = trained(**MEMORY)
    images, motion = seen(agent)
    sizes = {level.name: level.state_size for level in agent.description.levels}
    states = {name: np.zeros((BATCH, size), np.float32) for name, size in sizes.items()}
    # The intention is forced, or the other level would feel it through what is decided.
    forced = {"intention": np.ones((BATCH, 1), np.float32)}
    fresh = agent.act(images, motion, states, None, forced)
    after = agent.act(images, motion, {**states, carried: fresh.states[carried]}, None, forced)
    other = "trajectory" if carried == "intention" else "intention"
    assert np.abs(after.states[carried] - fresh.states[carried]).max() > 1e-3
    np.testing.assert_array_equal(after.states[other], fresh.states[other])


def marked(agent: Agent, new_sequence: Callable[..., Sequence], mark: int, length: int = 5) -> Sequence:
    """A sequence that carries `mark` in every frame, decision and reward."""
    sequence = new_sequence(agent, mark, length=length)
    sequence.images[:] = mark
    for column in (sequence.motion, *sequence.actions.values(), *sequence.rewards.values()):
        column[:] = mark
    return sequence


@pytest.mark.parametrize("memory", ["none", "lstm"])
def test_defect_7_training_joins_unrelated_sequences(
    new_agent: Callable[..., Agent],
    new_sequence: Callable[..., Sequence],
    replay_of: Callable[..., SequenceReplay],
    memory: str,
) -> None:
    agent = new_agent(memory=memory, n_step=3)
    stored = [marked(agent, new_sequence, mark, 1 + mark % 5) for mark in range(1, 9)]
    batch = replay_of(agent, stored).sample(400)
    if isinstance(batch, SequenceBatch):
        marks = batch.images[:, 0, 0, 0, 0]
        assert (batch.images == marks.reshape(-1, 1, 1, 1, 1)).all()
        assert all((rewards == marks[:, None]).all() for rewards in batch.rewards.values())
    else:
        marks = batch.images[0, :, 0, 0, 0]
        assert (batch.images == marks.reshape(1, -1, 1, 1, 1)).all()
        for rewards in batch.rewards.values():
            assert ((rewards == marks[:, None]) | (rewards == 0)).all()
        assert all((actions == marks[None, :, None]).all() for actions in batch.last_actions.values())
    assert set(marks) == set(range(1, 9))


@pytest.mark.parametrize("update_rule", ["ddpg", "td3"])
def test_defect_8_intention_has_no_noise(new_agent: Callable[..., Agent], update_rule: str) -> None:
    agent = new_agent(update_rule=update_rule, intention_noise=0.3)
    exploration = agent.description.levels[0].actions[0].exploration
    assert isinstance(exploration, Noise)
    assert exploration.low == exploration.high == 0.3
    images, motion = seen(agent)
    noise = {"intention": np.full((BATCH, 1), 0.25, np.float32)}
    greedy, noisy = (agent.act(images, motion, {}, given).actions["intention"] for given in (None, noise))
    np.testing.assert_allclose(noisy, greedy + 0.25, atol=1e-6)


@pytest.mark.parametrize("update_rule", ["ddpg", "td3", "sac"])
@pytest.mark.parametrize("memory", [{}, MEMORY])
def test_defect_8_trajectory_critic_never_reaches_the_intention_actor(
    new_agent: Callable[..., Agent],
    new_sequence: Callable[..., Sequence],
    replay_of: Callable[..., SequenceReplay],
    update_rule: str,
    memory: dict[str, Any],
) -> None:
    def moved(weight: float, level: str) -> torch.Tensor:
        """The first moment of the level's actor, a tenth of its first gradient."""
        agent = new_agent(
            update_rule=update_rule,
            intention_gradient=weight,
            saturation_penalty=0.0,
            gradient_norm=1e9,
            td3_actor_delay=1,
            **memory,
        )
        replay = replay_of(agent, [new_sequence(agent, seed) for seed in range(4)])
        agent.update(replay.sample(20))
        state = agent.state_dict()["actor_optimiser"]["state"]
        names = {id(tensor): place for place, tensor in enumerate(agent.state.actor_parameters)}
        (found,) = (each for each in agent.state.levels if each.name == level)
        return state[names[id(found.online.actor.layers.last.weight)]]["exp_avg"]

    alone, joint, twice = (moved(weight, "intention") for weight in (0.0, 1.0, 2.0))
    assert (joint - alone).abs().max() > 1e-9
    if update_rule != "sac":  # whose random numbers come in another order
        torch.testing.assert_close(twice - alone, 2 * (joint - alone), rtol=1e-3, atol=1e-9)
        # and it is the intention's alone: the trajectory's actor climbs its own value as before
        assert torch.equal(moved(0.0, "trajectory"), moved(1.0, "trajectory"))


def test_defect_8_both_levels_get_the_same_reward(
    new_agent: Callable[..., Agent],
    new_sequence: Callable[..., Sequence],
    replay_of: Callable[..., SequenceReplay],
) -> None:
    agent = new_agent(n_step=1, reward_scale=1.0, end_penalty=0.0)
    sequence = new_sequence(agent, 1)
    sequence.rewards["intention"][:] = 3.0
    sequence.rewards["trajectory"][:] = -7.0
    data = agent.prepare(replay_of(agent, [sequence]).sample(8))
    assert (data.levels["intention"].reward == 3.0).all()
    assert (data.levels["trajectory"].reward == -7.0).all()
