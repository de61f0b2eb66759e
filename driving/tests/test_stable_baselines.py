"""Stable-Baselines3 works with the town environment without an adapter."""

from __future__ import annotations

import athrl_driving  # noqa: F401  (registers the towns)
import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.env_checker import check_env

FEW_VEHICLES = {"vehicles_count": 20}
SMALL_REPLAY = {"buffer_size": 500, "learning_starts": 50, "batch_size": 16, "seed": 1, "device": "cpu"}


@pytest.mark.filterwarnings("error")
def test_its_checker_has_nothing_to_say_about_an_image_that_its_networks_take() -> None:
    environment = gymnasium.make("athrl/Town03-v0", config={**FEW_VEHICLES, "image_size": 64})
    check_env(environment.unwrapped, warn=True)


def test_its_checker_accepts_the_default_town() -> None:
    check_env(gymnasium.make("athrl/Town03-v0", config=FEW_VEHICLES).unwrapped, warn=False)


def test_ppo_trains_on_image_and_motion() -> None:
    environment = gymnasium.make("athrl/Town03-v0", config={**FEW_VEHICLES, "image_size": 64})
    model = PPO("MultiInputPolicy", environment, n_steps=32, batch_size=32, n_epochs=1, seed=1, device="cpu")
    assert _weights_move(model, 32)
    action, _ = model.predict(environment.reset(seed=3)[0], deterministic=True)
    assert environment.action_space.contains(action)


def test_td3_trains_on_the_default_town_flattened() -> None:
    environment = FlattenObservation(gymnasium.make("athrl/Town03-v0", config=FEW_VEHICLES))
    model = TD3("MlpPolicy", environment, policy_kwargs={"net_arch": [64]}, **SMALL_REPLAY)
    assert _weights_move(model, 60)


@pytest.mark.parametrize("action", ["WaypointSetAction", "DirectAction"])
def test_ppo_trains_on_the_other_kinds_of_action(action: str) -> None:
    config = {**FEW_VEHICLES, "action": {"type": action}}
    environment = FlattenObservation(gymnasium.make("athrl/Town03-v0", config=config))
    check_env(environment, warn=False)
    model = PPO("MlpPolicy", environment, n_steps=64, batch_size=32, n_epochs=1, seed=1, device="cpu")
    assert _weights_move(model, 128)
    action, _ = model.predict(environment.reset(seed=3)[0])
    assert environment.action_space.contains(action)


def test_sac_trains_on_acceleration_and_steering() -> None:
    config = {**FEW_VEHICLES, "action": {"type": "DirectAction"}}
    environment = FlattenObservation(gymnasium.make("athrl/Town03-v0", config=config))
    model = SAC("MlpPolicy", environment, policy_kwargs={"net_arch": [16]}, **SMALL_REPLAY)
    assert _weights_move(model, 60)


def _weights_move(model: PPO | SAC | TD3, steps: int) -> bool:
    before = [parameter.detach().clone().numpy() for parameter in model.policy.parameters()]
    model.learn(steps)
    after = [parameter.detach().numpy() for parameter in model.policy.parameters()]
    assert all(np.isfinite(values).all() for values in after)
    return any(not np.array_equal(old, new) for old, new in zip(before, after, strict=True))
