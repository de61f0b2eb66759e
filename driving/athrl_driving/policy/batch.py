"""A batch of environments that are stepped together, with their observations as rows of arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

import athrl_driving  # noqa: F401  (importing it registers the towns)

ENVIRONMENT_IDS = {"town03": "athrl/Town03-v0"}


def environment_config(
    *,
    vehicles: int,
    image_size: int,
    episode_ticks: int,
    ticks_per_decision: int,
    maximum_speed: float,
    waypoint_radius: float,
    waypoint_half_angle: float,
) -> dict[str, Any]:
    """A town environment's config from plain settings; `waypoint_half_angle` is in degrees."""
    return {
        "vehicles_count": vehicles,
        "image_size": image_size,
        "episode_ticks": episode_ticks,
        "ticks_per_decision": ticks_per_decision,
        "maximum_speed": maximum_speed,
        "waypoint_radius": waypoint_radius,
        "waypoint_half_angle": math.radians(waypoint_half_angle),
    }


@dataclass(frozen=True)
class BatchStep:
    """What a step returned: rewards float32 [batch], ends bool [batch], and gymnasium's info dicts.

    Rows that were not stepped have zeros, False and an empty dict.
    """

    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    infos: list[dict[str, Any]]


class EnvironmentBatch:
    """`count` environments of one town, with `images` uint8 [count, H, W, C] and `motion` float32 [count, m].

    After a step that ended an episode its rows hold the terminal observation until `reset` is called.
    """

    def __init__(self, town: str, config: Mapping[str, Any], count: int) -> None:
        if town not in ENVIRONMENT_IDS:
            raise ValueError(f"there is no town {town!r}; known are {', '.join(ENVIRONMENT_IDS)}")
        self.environments = [gymnasium.make(ENVIRONMENT_IDS[town], config=dict(config)) for _ in range(count)]
        space = self.environments[0].observation_space
        assert isinstance(space, gymnasium.spaces.Dict)
        self.images = np.zeros((count, *(space["image"].shape or ())), np.uint8)
        self.motion = np.zeros((count, *(space["motion"].shape or ())), np.float32)

    def __len__(self) -> int:
        return len(self.environments)

    def reset(self, row: int, seed: int) -> None:
        """Begin a new episode in one environment."""
        observation, _ = self.environments[row].reset(seed=seed)
        self._take(row, observation)

    def step(self, actions: np.ndarray, active: np.ndarray | None = None) -> BatchStep:
        """Step with `actions` float32 [count, 2] in [-1, 1]; only rows of `active` bool [count] if given."""
        count = len(self)
        result = BatchStep(
            np.zeros(count, np.float32), np.zeros(count, bool), np.zeros(count, bool), [{}] * count
        )
        for row, environment in enumerate(self.environments):
            if active is not None and not active[row]:
                continue
            observation, reward, terminated, truncated, info = environment.step(actions[row])
            self._take(row, observation)
            result.rewards[row] = float(reward)
            result.terminated[row] = terminated
            result.truncated[row] = truncated and not terminated
            result.infos[row] = info
        return result

    def close(self) -> None:
        """Close the environments."""
        for environment in self.environments:
            environment.close()

    def _take(self, row: int, observation: Mapping[str, np.ndarray]) -> None:
        self.images[row] = observation["image"]
        self.motion[row] = observation["motion"]
