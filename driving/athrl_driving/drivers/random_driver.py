"""The weakest reference driver."""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from athrl_driving.drivers.driver import Driver
from athrl_driving.envs import EnvView


class RandomDriver(Driver):
    """Draws every action uniformly."""

    def __init__(self) -> None:
        self._generator = np.random.default_rng(0)

    def reset(self, env: gymnasium.Env | EnvView, seed: int) -> None:
        """Begin an episode with a generator of its own, not the environment's of the same seed."""
        super().reset(env, seed)
        self._generator = np.random.default_rng([seed, 1])

    def act(self, env: gymnasium.Env | EnvView) -> NDArray[np.float32]:
        """Draw a uniform action."""
        return self._generator.uniform(-1.0, 1.0, size=2).astype(np.float32)
