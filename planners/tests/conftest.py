"""A small planner and made-up experience for the tests of this room."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from athrl_planners import ActionRange, AtHRL, ObservationSettings, PlannerSettings, Sequence, SequenceBatch

ACTIONS = {
    "intention": (ActionRange("intention", "", 0.0, 2.0, "ornstein-uhlenbeck", 0.2, 0.15),),
    "trajectory": (
        ActionRange("target_speed", "m/s", 0.0, 7.95, "ornstein-uhlenbeck", 0.2, 0.15),
        ActionRange("waypoint_angle", "rad", -0.52, 0.52, "gaussian", 0.1),
    ),
}
SETTINGS = PlannerSettings(
    hidden_features=32,
    recurrent_features=16,
    discount=0.97,
    learning_rate=1e-3,
    soft_target=0.005,
    reward_scale=0.02,
    saturation_penalty=0.02,
    twin_critics=True,
    actor_delay=2,
    target_noise=0.1,
    intention_gradient=1.0,
    gradient_norm=10.0,
    average_decay=0.995,
    burn_in=2,
)
OBSERVATION = ObservationSettings(image_size=16)
TIME = 5


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def make_agent() -> Callable[..., AtHRL]:
    """An agent of the small settings; keyword arguments change settings."""

    def make(seed: int = 1, image_size: int = 16, **changes: object) -> AtHRL:
        return AtHRL(replace(SETTINGS, **changes), ObservationSettings(image_size), ACTIONS, seed)

    return make


@pytest.fixture
def make_sequence() -> Callable[..., Sequence]:
    """A sequence of random numbers, by a seed; `start` stores a recurrent state of zeros."""

    def make(
        seed: int, length: int = TIME, terminated: bool = False, start: bool = False, time: int = TIME
    ) -> Sequence:
        random = np.random.default_rng(seed)
        state = np.zeros(32) if start else random.uniform(-0.5, 0.5, 32)
        speed, angle = random.uniform(0, 7.95, time), random.uniform(-0.52, 0.52, time)
        images = random.integers(0, 256, (time + 1, *OBSERVATION.image_shape), dtype=np.uint8)
        motion = random.normal(size=(time + 1, 2)).astype(np.float32)
        images[length + 1 :] = 0
        motion[length + 1 :] = 0
        padding = np.arange(time) >= length
        actions = {
            "intention": random.uniform(0, 2, (time, 1)).astype(np.float32),
            "trajectory": np.stack((speed, angle), axis=1).astype(np.float32),
        }
        rewards = {level: random.normal(0, 20, time).astype(np.float32) for level in ACTIONS}
        for column in (*actions.values(), *rewards.values()):
            column[padding] = 0
        return Sequence(
            images=images,
            motion=motion,
            actions=actions,
            rewards=rewards,
            initial_state={level: state.astype(np.float32) for level in ACTIONS},
            length=length,
            terminated=terminated,
        )

    return make


@pytest.fixture
def stack() -> Callable[[list[Sequence]], SequenceBatch]:
    """Sequences -> a batch of just these."""

    def make(sequences: list[Sequence]) -> SequenceBatch:
        def levels(column: str) -> dict[str, np.ndarray]:
            return {
                level: np.stack([getattr(sequence, column)[level] for sequence in sequences])
                for level in ACTIONS
            }

        return SequenceBatch(
            images=np.stack([sequence.images for sequence in sequences]),
            motion=np.stack([sequence.motion for sequence in sequences]),
            actions=levels("actions"),
            rewards=levels("rewards"),
            initial_state=levels("initial_state"),
            length=np.array([sequence.length for sequence in sequences]),
            terminated=np.array([sequence.terminated for sequence in sequences]),
        )

    return make
