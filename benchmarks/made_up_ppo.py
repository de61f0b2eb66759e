"""A PPO of Stable-Baselines3 that has collected a made-up rollout, for `benchmarks.updates`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv

from benchmarks.experience import synthetic_chunk
from benchmarks.peers.network import HIDDEN
from benchmarks.peers.stable_baselines import Features

ENVIRONMENTS, STEPS, BATCH, SIZE = 32, 128, 512, 32


class _Seen(gymnasium.Env):
    """Only spaces; it is not driven."""

    observation_space = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (4, SIZE, SIZE), np.uint8),
            "motion": spaces.Box(-2.0, 2.0, (2,), np.float32),
        }
    )
    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Not driven."""
        raise NotImplementedError


def made_up_ppo() -> PPO:
    """PPO with a full buffer; `train()` goes through it once."""
    model = PPO(
        "MultiInputPolicy",
        DummyVecEnv([_Seen] * ENVIRONMENTS),
        n_steps=STEPS,
        batch_size=BATCH,
        n_epochs=1,
        policy_kwargs={"features_extractor_class": Features, "net_arch": list(HIDDEN)},
        device="cpu",
    )
    model.policy.to(memory_format=torch.channels_last)
    model.set_logger(Logger(None, []))
    buffer = model.rollout_buffer
    assert isinstance(buffer, DictRolloutBuffer)
    random = np.random.default_rng(0)
    images = np.stack([synthetic_chunk(STEPS - 1, seed=seed).images for seed in range(ENVIRONMENTS)], axis=1)
    buffer.observations["image"][:] = images.transpose(0, 1, 4, 2, 3)
    for column in (buffer.observations["motion"], buffer.actions):
        column[:] = random.uniform(-1, 1, column.shape)
    for column in (buffer.values, buffer.advantages, buffer.returns):
        column[:] = random.normal(size=column.shape)
    buffer.log_probs[:] = -2.0
    buffer.full, buffer.pos = True, STEPS
    return model
