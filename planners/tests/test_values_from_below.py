"""What an intention is worth is what the trajectory planner makes of it, whatever the noise was."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from athrl_planners import Agent, LevelPlan, Sequence, SequenceReplay
from athrl_planners.training.losses import critic_loss, joined
from athrl_spaces import Continuous
from pydantic import ValidationError

NewAgent = Callable[..., Agent]


@pytest.fixture
def replay(
    new_agent: NewAgent, new_sequence: Callable[..., Sequence], replay_of: Callable[..., SequenceReplay]
) -> SequenceReplay:
    agent = new_agent()
    return replay_of(agent, [new_sequence(agent, seed, terminated=True) for seed in range(4)])


def intention_value_and_error(agent: Agent, batch: Any) -> tuple[float, float]:
    metrics = critic_loss(agent.state, agent.prepare(batch)).metrics
    return float(metrics["intention/value"]), float(metrics["intention/td_error"])


def test_target_is_the_smaller_trajectory_critics_value_of_its_own_decision(
    new_agent: NewAgent, replay: SequenceReplay
) -> None:
    agent = new_agent(critic="scalar", td3_target_noise=0.0)
    batch = replay.sample(12)
    data, state = agent.prepare(batch), agent.state
    intention, trajectory = state.levels
    with torch.no_grad():
        context = data.frames.current(state.trunk("trajectory"), None)
        taken = data.levels["intention"].taken
        actor = trajectory.online.actor
        assert actor is not None
        action = (1.1 * torch.tanh(actor(context, taken))).clamp(-1, 1)
        values = [critic(context, taken, action)[:, 0] for critic in trajectory.online.critics]
        wanted = torch.minimum(*values)
        said = intention.online.critics[0](context, joined([], context), taken)[:, 0]
    _, error = intention_value_and_error(agent, batch)
    assert error == pytest.approx(float((said - wanted).abs().mean()), rel=1e-4)


@pytest.mark.parametrize(("target", "counts"), [("trajectory", False), ("experience", True)])
def test_rewards_of_noisy_driving_count_only_in_values_from_experience(
    new_agent: NewAgent, replay: SequenceReplay, target: str, counts: bool
) -> None:
    agent = new_agent(intention_target=target, td3_target_noise=0.0)
    batch = replay.sample(12)
    worse = {level: rewards - 50.0 for level, rewards in batch.rewards.items()}
    actions = {**batch.actions, "trajectory": batch.actions["trajectory"][::-1]}
    noisy = replace(batch, rewards=worse, actions=actions)
    _, error = intention_value_and_error(agent, batch)
    _, other = intention_value_and_error(agent, noisy)
    assert (not np.isclose(error, other)) == counts


def test_intention_paid_otherwise_is_not_worth_what_the_trajectory_critics_say(new_agent: NewAgent) -> None:
    new_agent(intention_reward="progress", intention_target="experience")
    with pytest.raises(ValidationError, match=r'should go with planner\.intention_target = "experience"'):
        new_agent(intention_reward="progress")


def test_level_without_one_below_that_is_paid_the_same_cannot_take_its_values(
    fresh_registry: Callable[[], None], monkeypatch: pytest.MonkeyPatch, new_agent: NewAgent
) -> None:
    from athrl_planners.hddpg import HDDPG

    def alone(settings: Any, limits: Any) -> tuple[LevelPlan, ...]:
        speed, angle = HDDPG.actions(limits, settings.noise)
        assert isinstance(speed, Continuous)
        return (LevelPlan("trajectory", (speed, angle), "td3", value_from="below"),)

    monkeypatch.setattr(HDDPG, "levels", alone)
    with pytest.raises(ValueError, match="level trajectory learns values from below"):
        new_agent("hddpg")
