"""Exploration of a batch of environments, as a policy's description specifies it.

The amount of exploration depends on an environment's rank. Noise of a continuous action is kept in units of
half its range and scaled to physical units when it is drawn, so one setting explores every action equally.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from athrl_spaces import Continuous, Discrete, LevelDescription, Noise, PolicyDescription, Sampled
from athrl_spaces.actions import Action
from numpy.typing import NDArray


@dataclass(frozen=True)
class Exploration:
    """Exploration of one decision of a batch; both fields are arguments of `OnnxPolicy.step`.

    Attributes:
        noise: of each level with a continuous action float32 [batch, n]: physical units, or a standard
            normal number where the policy samples; 0 for choices.
        forced: of each level with a forced action float32 [batch, n]: numbers in physical units, choices as
            their index, NaN where the policy decides.
    """

    noise: dict[str, NDArray[np.float32]]
    forced: dict[str, NDArray[np.float32]]


class ExplorationNoise:
    """Exploration of each level of a policy.

    Noise has a memory for each environment, which is cleared at the start of an episode.

    Args:
        description: of the policy.
        ranks: float64 [batch], from 0, the least exploration, to 1, the most.
        rng: the only source of randomness.
    """

    def __init__(
        self, description: PolicyDescription, ranks: NDArray[np.float64], rng: np.random.Generator
    ) -> None:
        self._rng = rng
        self._levels = [_LevelExploration(level, ranks) for level in description.levels]

    def reset(self, environment: int) -> None:
        """Clear the noise of one environment at the start of its episode."""
        for level in self._levels:
            level.memory[environment] = 0

    def draw(self, scale: float = 1.0) -> Exploration:
        """Exploration of the next decision: noise, and the probability of random choices, times `scale`."""
        noise, forced = {}, {}
        for level in self._levels:
            if level.is_continuous.any():
                noise[level.name] = level.draw_noise(self._rng, scale)
            if not level.is_continuous.all():
                forced[level.name] = level.draw_choices(self._rng, scale)
        return Exploration(noise, forced)

    def uniform(self) -> Exploration:
        """Decisions drawn uniformly from all possible ones; all are forced, there is no noise."""
        return Exploration({}, {level.name: level.uniform(self._rng) for level in self._levels})

    def state(self) -> dict[str, Any]:
        """The state for `load_state`: that of the generator, and each level's memory float64 [batch, n]."""
        memory = {level.name: level.memory.copy() for level in self._levels}
        return {"random": self._rng.bit_generator.state, "memory": memory}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue from `state()`: the next draws are the same.

        Raises:
            KeyError, ValueError: `state` does not fit.
        """
        self._rng.bit_generator.state = state["random"]
        for level in self._levels:
            level.memory[:] = state["memory"][level.name]


class _LevelExploration:
    """Exploration of one level; a sampled number is noise of deviation 1 without memory."""

    def __init__(self, level: LevelDescription, ranks: NDArray[np.float64]) -> None:
        self.name = level.name
        self.is_continuous = np.array([isinstance(action, Continuous) for action in level.actions])
        self.memory = np.zeros((len(ranks), level.action_size))
        self._low, self._high = level.low, level.high
        self._choices = np.array([_choices(action) for action in level.actions])
        self._deviations = np.stack([_deviations(action, ranks) for action in level.actions], axis=1)
        self._probabilities = np.stack([_probabilities(action, ranks) for action in level.actions], axis=1)
        self._kept = np.array([_kept(action) for action in level.actions])
        self._units = np.array([_unit(action) for action in level.actions])

    def draw_noise(self, rng: np.random.Generator, scale: float) -> NDArray[np.float32]:
        fresh = rng.standard_normal(self.memory.shape) * self._deviations
        self.memory = self.memory * self._kept + fresh
        return (scale * self.memory * self._units).astype(np.float32)

    def draw_choices(self, rng: np.random.Generator, scale: float) -> NDArray[np.float32]:
        is_random = rng.random(self.memory.shape) < scale * self._probabilities
        return np.where(is_random, self.uniform(rng), np.float32(np.nan))

    def uniform(self, rng: np.random.Generator) -> NDArray[np.float32]:
        numbers = rng.uniform(self._low, self._high, self.memory.shape)
        choices = rng.integers(0, self._choices, self.memory.shape)
        return np.where(self.is_continuous, numbers, choices).astype(np.float32)


def _deviations(action: Action, ranks: NDArray[np.float64]) -> NDArray[np.float64]:
    if isinstance(action.exploration, Noise):
        return action.exploration.deviations(ranks)
    return np.full(len(ranks), 1.0 if isinstance(action.exploration, Sampled) else 0.0)


def _probabilities(action: Action, ranks: NDArray[np.float64]) -> NDArray[np.float64]:
    return action.exploration.probabilities(ranks) if isinstance(action, Discrete) else np.zeros(len(ranks))


def _choices(action: Action) -> int:
    return len(action.choices) if isinstance(action, Discrete) else 1


def _kept(action: Action) -> float:
    """Share of the noise that remains at the next decision."""
    return 1.0 - action.exploration.damping if isinstance(action.exploration, Noise) else 0.0


def _unit(action: Action) -> float:
    """Physical size of a noise of 1."""
    return (
        action.half_range if isinstance(action.exploration, Noise) and isinstance(action, Continuous) else 1.0
    )
