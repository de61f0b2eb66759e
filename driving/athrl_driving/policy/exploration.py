"""Exploration noise of a batch of environments, as the artefact's metadata asks for it.

The Ornstein-Uhlenbeck process is that of tf-agents: `x <- (1 - damping) x + noise_scale N(0, 1)`.
It is held in half-ranges and scaled to physical units when drawn, so one setting explores every action alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from athrl_driving.policy.metadata import LevelMetadata, PolicyMetadata


class ExplorationNoise:
    """Noise for each level of a policy, with a memory per environment that an episode's start clears."""

    def __init__(self, metadata: PolicyMetadata, batch: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._levels = [_LevelNoise(level, batch) for level in metadata.levels]

    def reset(self, environment: int) -> None:
        """Forget the noise of one environment: its episode begins."""
        for level in self._levels:
            level.memory[environment] = 0

    def draw(self, scale: float = 1.0) -> dict[str, np.ndarray]:
        """The next decision's noise: float32 [batch, n] of each level, physical units, times `scale`."""
        return {level.name: level.draw(self._rng, scale) for level in self._levels}

    def state(self) -> dict[str, Any]:
        """What `load_state` goes on from: the generator's state, each level's memory float64 [batch, n]."""
        memory = {level.name: level.memory.copy() for level in self._levels}
        return {"random": self._rng.bit_generator.state, "memory": memory}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on from `state()`; the next draws are the same."""
        self._rng.bit_generator.state = state["random"]
        for level in self._levels:
            level.memory[:] = state["memory"][level.name]

    def uniform(self) -> dict[str, np.ndarray]:
        """Actions drawn evenly from their whole ranges: float32 [batch, n] of each level, physical units."""
        return {level.name: level.uniform(self._rng) for level in self._levels}


class _LevelNoise:
    """The noise of one level; a Gaussian action is a process that forgets everything at once."""

    def __init__(self, level: LevelMetadata, batch: int) -> None:
        self.name = level.name
        self._low, self._high = level.low, level.high
        self.memory = np.zeros((batch, level.action_size), np.float64)
        self._half_range = level.half_range
        self._deviation = np.array([action.noise_scale for action in level.actions])
        self._kept = np.array(
            [1 - action.damping if action.noise == "ornstein-uhlenbeck" else 0.0 for action in level.actions]
        )

    def uniform(self, rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(self._low, self._high, self.memory.shape).astype(np.float32)

    def draw(self, rng: np.random.Generator, scale: float) -> np.ndarray:
        fresh = rng.standard_normal(self.memory.shape) * self._deviation
        self.memory = self.memory * self._kept + fresh
        return (scale * self.memory * self._half_range).astype(np.float32)
