"""A planner of one's own: a class and a line in the registry, and everything else follows."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest
from athrl_planners import (
    Agent,
    LevelPlan,
    Planner,
    PolicyExporter,
    Sequence,
    SequenceReplay,
    make_agent,
    planner,
    registry,
    settings_tables,
)
from athrl_planners.settings import ActorCriticSettings
from athrl_spaces import DIRECT, Limits, Observation
from pydantic import Field


class PedalsSettings(ActorCriticSettings):
    """Pedals: steering is decided for what the pedals do."""

    pedal_every: int = Field(default=2, ge=1, le=10, description="Decisions for which the pedals are held.")


class Pedals(Planner):
    kind = "pedals"
    summary = "steering under acceleration"
    settings = PedalsSettings
    action_kind: ClassVar[str] = DIRECT

    @classmethod
    def levels(cls, settings: PedalsSettings, limits: Limits) -> tuple[LevelPlan, ...]:
        acceleration, steering = cls.actions(limits, settings.noise)
        return (
            LevelPlan("pedals", (acceleration,), settings.update_rule, every=settings.pedal_every),
            LevelPlan("wheel", (steering,), settings.update_rule),
        )


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch, fresh_registry: Callable[[], None]) -> None:
    module = ModuleType("planner_of_a_test")
    module.Pedals = Pedals  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(registry.PLANNERS, "pedals", f"{module.__name__}:Pedals")
    fresh_registry()


@pytest.fixture
def agent(
    new_sequence: Callable[..., Sequence], replay_of: Callable[..., SequenceReplay]
) -> Callable[..., Agent]:
    """The planner, trained a little."""

    def make(**settings: object) -> Agent:
        small = {"hidden_features": 16, "head_features": 16, "recurrent_features": 8, "average_decay": 0.2}
        agent = make_agent("pedals", {**small, **settings}, observation=Observation(8), seed=1)
        replay = replay_of(agent, [new_sequence(agent, seed) for seed in range(3)])
        for _ in range(5):
            agent.update(replay.sample(10))
        return agent

    return make


def test_registry_knows_it_and_its_settings() -> None:
    assert planner("pedals") is Pedals
    assert settings_tables()["pedals"] is PedalsSettings


@pytest.mark.parametrize("memory", ["none", "lstm"])
def test_its_artefact_drives_with_what_drives_every_other(agent: Callable[..., Agent], memory: str) -> None:
    policies = pytest.importorskip("athrl_driving.policy")
    trained = agent(memory=memory)
    policy = policies.OnnxPolicy(PolicyExporter(trained).artefact())
    assert policy.description == trained.description
    assert [level.name for level in policy.description.levels] == ["pedals", "wheel"]
    random = np.random.default_rng(1)
    exploration = policies.ExplorationNoise(policy.description, np.array([0.0, 1.0]), random)
    states, own, pedals = policy.initial_states(2), policy.initial_states(2), []
    for _ in range(4):
        images, motion = random.integers(0, 256, (2, 8, 8, 4), np.uint8), np.zeros((2, 2), np.float32)
        explored = exploration.draw(1.0)
        step = policy.step(images, motion, states, explored.noise, explored.forced)
        expected = trained.act(images, motion, own, explored.noise, explored.forced)
        for level in ("pedals", "wheel"):
            np.testing.assert_allclose(step.actions[level], expected.actions[level], atol=1e-5)
        states, own = step.states, {**own, **expected.states}
        action = policy.description.environment_action(step.actions)
        assert action.shape == (2, 2)
        assert (np.abs(action) <= 1).all()
        pedals.append(step.actions["pedals"])
    np.testing.assert_array_equal(pedals[0], pedals[1])
    assert (pedals[1] != pedals[2]).all()
