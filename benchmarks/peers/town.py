"""The town as a gymnasium environment, for training and scoring of peers."""

from __future__ import annotations

from typing import Any

import athrl_driving  # noqa: F401  (registers the towns)
import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from scipy.stats import t as student

from benchmarks.peers.comparison import Act, Comparison

REWARD_SCALE = 0.02
"""Factor on rewards while a peer trains, as in our default run; scores are of the reward as it is."""

_REGISTERED = ("town02", "town03", "town04")


def make_towns(comparison: Comparison, count: int, autoreset_mode: AutoresetMode) -> VectorEnv:
    """Make `count` environments that are stepped together, on as many threads as there are cores."""
    named = comparison.town in _REGISTERED
    where: dict[str, Any] = {} if named else {"map": comparison.town}
    return gymnasium.make_vec(
        f"athrl/{comparison.town.capitalize()}-v0" if named else "athrl/OpenDrive-v0",
        num_envs=count,
        vectorization_mode="vector_entry_point",
        config={"vehicles_count": comparison.vehicles},
        autoreset_mode=autoreset_mode,
        **where,
    )


class Examination:
    """The scored episodes, the same for all contestants."""

    def __init__(self, comparison: Comparison) -> None:
        self._towns = make_towns(comparison, comparison.episodes, AutoresetMode.NEXT_STEP)
        self._seeds = [comparison.first_seed + episode for episode in range(comparison.episodes)]
        standing = np.zeros((comparison.episodes, 2), np.float32)
        self.score(lambda _: standing)  # compiles, so that it does not count as training

    def score(self, act: Act) -> dict[str, float]:
        """Drive every episode greedily to its end; return what `athrl evaluate` would."""
        observation, _ = self._towns.reset(seed=self._seeds)
        count = len(self._seeds)
        returns, driving = np.zeros(count), np.ones(count, np.bool_)
        ends = {name: np.zeros(count, np.bool_) for name in ("collision", "off_lane", "full_episode")}
        while driving.any():
            observation, reward, terminated, truncated, info = self._towns.step(act(observation))
            returns += reward * driving
            ended = (terminated | truncated) & driving
            for name in ("collision", "off_lane"):
                ends[name][ended] = info[name][ended]
            ends["full_episode"][ended] = truncated[ended]
            driving &= ~ended
        rates = {f"{name}_rate": float(values.mean()) for name, values in ends.items()}
        return {"return_mean": float(returns.mean()), "return_ci95": _interval(returns), **rates}


def _interval(values: np.ndarray) -> float:
    """Half the width of the mean's 95 % interval."""
    return float(student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
