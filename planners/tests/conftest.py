"""Small planners and synthetic experience for the tests of this package."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from athrl_planners import Agent, Sequence, SequenceBatch, SequenceReplay, make_agent, planners
from athrl_planners.factories import make_replay
from athrl_spaces import Continuous, LevelDescription, Observation

TIME = 5
SMALL = {"hidden_features": 16, "head_features": 24, "recurrent_features": 8, "atoms": 11}
OBSERVATION = Observation(8)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def new_agent() -> Callable[..., Agent]:
    """A small agent; keyword arguments that it does not name are settings of its planner."""

    def make(
        kind: str = "athrl", *, seed: int = 1, burn_in: int = 0, image_size: int = 8, **settings: Any
    ) -> Agent:
        return make_agent(
            kind, {**SMALL, **settings}, observation=Observation(image_size), seed=seed, burn_in=burn_in
        )

    return make


def _state(level: LevelDescription, held: bool, random: np.random.Generator) -> np.ndarray:
    """A recurrent state; `held`: with its last two numbers a decision and for how many more it is held."""
    state = random.uniform(-0.5, 0.5, level.state_size).astype(np.float32)
    if held:
        state[-2:] = random.uniform(0, 2), random.integers(2)
    return state


def _actions(level: LevelDescription, time: int, random: np.random.Generator) -> np.ndarray:
    columns = [
        random.uniform(*action.bounds, time)
        if isinstance(action, Continuous)
        else random.integers(len(action.choices), size=time)
        for action in level.actions
    ]
    return np.stack(columns, axis=1).astype(np.float32)


@pytest.fixture
def new_sequence() -> Callable[..., Sequence]:
    """A sequence of random numbers for an agent, by a seed; `start`: an episode begins with it."""

    def make(
        agent: Agent,
        seed: int,
        length: int = TIME,
        terminated: bool = False,
        start: bool = False,
        time: int = TIME,
    ) -> Sequence:
        random = np.random.default_rng(seed)
        observation = agent.description.observation
        images = random.integers(0, 256, (time + 1, *observation.image_shape), dtype=np.uint8)
        motion = random.normal(size=(time + 1, 2)).astype(np.float32)
        images[length + 1 :] = 0
        motion[length + 1 :] = 0
        actions, rewards, states = {}, {}, {}
        for level, trained in zip(agent.description.levels, agent.state.levels, strict=True):
            actions[level.name] = _actions(level, time, random)
            rewards[level.name] = random.normal(0, 20, time).astype(np.float32)
            state = _state(level, trained.plan.every > 1, random)
            states[level.name] = np.zeros_like(state) if start else state
        for column in (*actions.values(), *rewards.values()):
            column[length:] = 0
        return Sequence(images, motion, actions, rewards, states, length, terminated)

    return make


def _stacked(sequences: list[Sequence], column: str) -> dict[str, np.ndarray]:
    return {
        level: np.stack([getattr(sequence, column)[level] for sequence in sequences])
        for level in sequences[0].actions
    }


@pytest.fixture
def stack() -> Callable[..., SequenceBatch]:
    """Sequences -> a batch of just these."""

    def make(sequences: list[Sequence], weights: list[float] | None = None) -> SequenceBatch:
        return SequenceBatch(
            images=np.stack([sequence.images for sequence in sequences]),
            motion=np.stack([sequence.motion for sequence in sequences]),
            actions=_stacked(sequences, "actions"),
            rewards=_stacked(sequences, "rewards"),
            initial_state=_stacked(sequences, "initial_state"),
            length=np.array([sequence.length for sequence in sequences]),
            terminated=np.array([sequence.terminated for sequence in sequences]),
            places=np.arange(len(sequences)),
            weights=np.ones(len(sequences), np.float32) if weights is None else np.float32(weights),
        )

    return make


@pytest.fixture
def replay_of() -> Callable[..., SequenceReplay]:
    """A replay, as large as needed, that holds these sequences in its slots 0, 1, ..."""

    def make(
        agent: Agent, sequences: list[Sequence], seed: int = 1, priority: tuple[float, float] | None = None
    ) -> SequenceReplay:
        time = len(sequences[0].motion) - 1
        replay = make_replay(agent, time * len(sequences), time, seed, priority)
        for sequence in sequences:
            replay.insert(sequence)
        return replay

    return make


@pytest.fixture
def fresh_registry() -> Iterator[Callable[[], None]]:
    """Call it after a change of the registry; the next test looks again, too."""
    yield planners.cache_clear
    planners.cache_clear()
