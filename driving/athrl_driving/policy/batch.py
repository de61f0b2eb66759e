"""A batch of environments that are stepped together, each begun by its own seed when its driver wants it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from athrl_driving.envs import TownRow, TownVectorEnv
from athrl_driving.policy.recording import Recording


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
    """What a step returned: rewards float32 [batch], ends bool [batch], and infos as gymnasium's vectors do.

    Rows that were not stepped have zeros and False.
    """

    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    infos: Mapping[str, Any]


class EnvironmentBatch:
    """`count` environments of one town, with `images` uint8 [count, H, W, C] and `motion` float32 [count, m].

    `images` and `motion` change with every step. After one that ended an episode its rows hold the terminal
    observation until `reset` is called. `town` is a town's name or the path of an OpenDRIVE file. `recording`
    has room for `recorded` decisions of each environment.
    """

    def __init__(self, town: str, config: Mapping[str, Any], count: int, recorded: int = 0) -> None:
        self._vector = TownVectorEnv(
            count,
            config=config,
            map=town,
            autoreset_mode=AutoresetMode.DISABLED,
            recorded=recorded,
        )
        self.images, self.motion = self._vector.images, self._vector.motion
        self.recording = Recording(self._vector.episodes.state.tape, self.images.shape[1:])
        self.environments: list[TownRow] = [self._vector.row(row) for row in range(count)]

    def __len__(self) -> int:
        return self._vector.num_envs

    def reset(self, row: int, seed: int) -> None:
        """Begin a new episode in one environment."""
        self._vector.reset_row(row, seed)

    def step(self, actions: np.ndarray, active: np.ndarray | None = None) -> BatchStep:
        """Step with `actions` float32 [count, 2] in [-1, 1]; only rows of `active` bool [count] if given."""
        rows = np.ones(len(self), bool) if active is None else active
        rewards, terminated, truncated, infos = self._vector.step_rows(actions, rows)
        return BatchStep(rewards.astype(np.float32), terminated, truncated, infos)

    def info(self, row: int) -> dict[str, Any]:
        """What `info` tells of one environment's last decision."""
        return self._vector.episodes.info(row)

    def close(self) -> None:
        """Close the environments."""
        self._vector.close()
