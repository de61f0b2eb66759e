"""Stable-Baselines3's PPO, TD3 and SAC, with its own implementation of everything but the image encoder."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from benchmarks.peers.comparison import Act, Observation, Training
from benchmarks.peers.network import FEATURES, HIDDEN, Encoder
from benchmarks.peers.town import REWARD_SCALE, make_towns

DISCOUNT = 0.97
RATE = 3e-4
ENDLESS = 10**9
"""Decisions: the clock ends the training, not a number."""


class TownVecEnv(VecEnv):
    """A gymnasium vector of towns as Stable-Baselines3 wants one.

    Images have their channels first, rewards are scaled. The towns reset within the step, and what was last
    seen is in the info's `terminal_observation`, from which a truncated episode is bootstrapped.
    """

    def __init__(self, towns: VectorEnv) -> None:
        self.towns = towns
        seen = towns.single_observation_space
        size, _, channels = seen["image"].shape
        image = spaces.Box(0, 255, (channels, size, size), np.uint8)
        space = spaces.Dict({"image": image, "motion": seen["motion"]})
        super().__init__(towns.num_envs, space, towns.single_action_space)

    def reset(self) -> Observation:
        """Begin new episodes with the seeds of `seed`."""
        observation, _ = self.towns.reset(seed=self._seeds)
        self._reset_seeds()
        return _channels_first(observation)

    def step_async(self, actions: NDArray) -> None:
        """Take the actions [num_envs, 2] of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, NDArray, NDArray, list[dict[str, Any]]]:
        """Make the step; `infos` say what only an ended episode has to say."""
        observation, reward, terminated, truncated, info = self.towns.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = terminated | truncated
        for e in np.flatnonzero(ended).tolist():
            last = {name: values[None] for name, values in info["final_obs"][e].items()}
            infos[e] = {
                "terminal_observation": {name: values[0] for name, values in _channels_first(last).items()},
                "TimeLimit.truncated": bool(truncated[e] and not terminated[e]),
            }
        scaled = (reward * REWARD_SCALE).astype(np.float32)
        return _channels_first(observation), scaled, ended, infos

    def close(self) -> None:
        """End the towns' threads."""
        self.towns.close()

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """An attribute of the vector, for each environment."""
        return [getattr(self.towns, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Not for towns, whose settings are fixed when they are made."""
        raise NotImplementedError

    def env_method(
        self, method_name: str, *arguments: Any, indices: int | Iterable[int] | None = None, **named: Any
    ) -> list[Any]:
        """Not for towns: those of a vector have no methods of their own."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: type, indices: int | Iterable[int] | None = None) -> list[bool]:
        """None is."""
        return [False for _ in self._get_indices(indices)]


class Features(BaseFeaturesExtractor):
    """The encoder in Stable-Baselines3's place for one; it has brought the image to 0 to 1 before."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        super().__init__(observation_space, FEATURES)
        channels, size, _ = observation_space["image"].shape
        self.encoder = Encoder(channels, size, observation_space["motion"].shape[0])

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Encode a batch."""
        return self.encoder(observations["image"], observations["motion"])


class Clock(BaseCallback):
    """Ends the training with its time, and has it scored on the way."""

    def __init__(self, training: Training) -> None:
        super().__init__()
        self._training = training

    def _on_training_start(self) -> None:
        self._training.begin()

    def _on_step(self) -> bool:
        return self._training.goes_on(self.num_timesteps, _greedy(self.model))


def train_ppo(training: Training) -> dict[str, Any]:
    """PPO: 32 environments of 128 steps, then 4 epochs in batches of 512."""
    return _train(PPO, training, environments=32, n_steps=128, batch_size=512, n_epochs=4)


def train_td3(training: Training) -> dict[str, Any]:
    """TD3: an update of 512 for each step of 64 environments, a replay of 200,000."""
    noise = NormalActionNoise(np.zeros(2), np.full(2, 0.2))
    return _train(TD3, training, action_noise=noise, **_OFF_POLICY)


def train_sac(training: Training) -> dict[str, Any]:
    """SAC: like TD3, its temperature learned."""
    return _train(SAC, training, ent_coef="auto", **_OFF_POLICY)


_OFF_POLICY: dict[str, Any] = {
    "environments": 64,
    "batch_size": 512,
    "buffer_size": 200_000,
    "learning_starts": 10_000,
    "train_freq": 1,
    "gradient_steps": 1,
    "tau": 0.02,
}


def _train(
    algorithm: type[BaseAlgorithm], training: Training, environments: int, **settings: Any
) -> dict[str, Any]:
    """Train until the time is over; return the settings."""
    towns = TownVecEnv(make_towns(training.comparison, environments, AutoresetMode.SAME_STEP))
    model = algorithm(
        "MultiInputPolicy",
        towns,
        learning_rate=lambda _: training.falling(RATE),
        gamma=DISCOUNT,
        policy_kwargs={"features_extractor_class": Features, "net_arch": list(HIDDEN)},
        seed=training.comparison.training_seed,
        device="cpu",
        **settings,
    )
    model.policy.to(memory_format=torch.channels_last)
    model.learn(ENDLESS, callback=Clock(training))
    training.end(model.num_timesteps, _greedy(model))
    towns.close()
    told = {name: value for name, value in settings.items() if isinstance(value, int | float | str)}
    return {"environments": environments, "gamma": DISCOUNT, "learning_rate": RATE, **told}


def _greedy(model: BaseAlgorithm) -> Act:
    return lambda observation: model.predict(_channels_first(observation), deterministic=True)[0]


def _channels_first(observation: Observation) -> Observation:
    image = np.ascontiguousarray(observation["image"].transpose(0, 3, 1, 2))
    return {"image": image, "motion": observation["motion"]}
