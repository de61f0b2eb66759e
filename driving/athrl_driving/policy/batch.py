"""A batch of environments that are stepped together, each begun by its own seed when its driver wants it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from athrl_spaces import PolicyDescription
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from athrl_driving.envs import TownEnv, TownRow, TownVectorEnv
from athrl_driving.envs.settings import action_setting, changed_settings
from athrl_driving.envs.vector_env import cores
from athrl_driving.episode import Crew, new_sight
from athrl_driving.errors import DrivingError
from athrl_driving.policy.infos import common_infos
from athrl_driving.policy.recording import Recording
from athrl_driving.policy.towns import ranks_within_towns, rows_of_towns


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


def config_of(description: PolicyDescription) -> dict[str, Any]:
    """What a policy says of its environments' config: the image, the kind of action, what an action means."""
    limits = description.limits
    return {
        "image_size": description.observation.image_size,
        "maximum_speed": limits.maximum_speed,
        "waypoint_radius": limits.waypoint_radius,
        "waypoint_half_angle": limits.waypoint_half_angle,
        "action": action_setting(description.action_kind),
    }


@dataclass(frozen=True)
class BatchStep:
    """What a step returned: rewards float32 [batch], ends bool [batch], and infos as gymnasium's vectors do.

    Rows that were not stepped have zeros and False.
    """

    rewards: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    infos: Mapping[str, Any]


class EnvironmentBatch:
    """Environments of one or several towns, one for each entry of `towns`.

    Args:
        towns: of each environment the name of its town or the path of an OpenDRIVE file, in any order.
        config: of the environments, without `town` and `action`.
        action_kind: name of the kind of action that they take (`athrl_spaces.ACTION_KINDS`).
        recorded: decisions for which `recording` has room in each environment.

    Attributes:
        images: uint8 [count, H, W, C]; it changes with every step. After one that ended an episode its row
            holds the terminal observation until `reset` is called.
        motion: float32 [count, m] that goes with it.
        recording: what was seen and earned since each environment's tape was rewound.
        environments: each environment as an object, for drivers and viewers.
        towns: of each environment, as given.
        ranks: float64 [count], evenly from 0 to 1 among the environments of a town: how much each explores.
        action_kind: as given.

    Raises:
        ValueError: there is no such town, kind of action or setting, or no environment at all; in one line.
    """

    def __init__(
        self,
        towns: Sequence[str],
        config: Mapping[str, Any],
        action_kind: str = "waypoint",
        recorded: int = 0,
    ) -> None:
        if isinstance(towns, str) or not len(towns):
            raise DrivingError(f"the towns are {towns!r}; there should be one for each environment")
        self.towns = list(towns)
        self.ranks: NDArray[np.float64] = ranks_within_towns(self.towns)
        self.action_kind = action_kind
        settings = {**config, "action": action_setting(action_kind)}
        image_size = changed_settings(TownEnv.default_config(), settings, None)["image_size"]
        sight = new_sight(len(self.towns), int(image_size), recorded)
        self.images, self.motion = sight.images, sight.motion
        self.recording = Recording(sight.tape, self.images.shape[1:])
        self._rows = list(rows_of_towns(self.towns).values())
        self._crew = Crew(cores())
        self._vectors = [
            TownVectorEnv(
                len(rows),
                config=settings,
                map=self.towns[rows[0]],
                autoreset_mode=AutoresetMode.DISABLED,
                sight=sight._replace(rows=rows),
                crew=self._crew,
            )
            for rows in self._rows
        ]
        self._places = {
            row: (vector, place)
            for vector, rows in zip(self._vectors, self._rows, strict=True)
            for place, row in enumerate(rows.tolist())
        }
        self.environments: list[TownRow] = [
            self._places[row][0].row(self._places[row][1]) for row in range(len(self))
        ]

    def __len__(self) -> int:
        return len(self.towns)

    def reset(self, row: int, seed: int) -> None:
        """Begin a new episode in one environment."""
        vector, place = self._places[row]
        vector.reset_row(place, seed)

    def step(self, actions: NDArray[np.float32], active: NDArray[np.bool_] | None = None) -> BatchStep:
        """Make a decision in every environment, or in those of `active` bool [count] alone.

        Args:
            actions: float32 [count, 2]; within [-1, 1], or choices for the kind `waypoint-set`.
            active: the rows to step.

        Raises:
            DrivingError: an action is none; nothing has moved.
        """
        chosen = np.ones(len(self), np.bool_) if active is None else active
        if len(self._vectors) == 1:
            rewards, terminated, truncated, infos = self._vectors[0].step_rows(actions, chosen)
            return BatchStep(rewards.astype(np.float32), terminated, truncated, infos)
        return self._step_towns(actions, chosen)

    def _step_towns(self, actions: NDArray[np.float32], chosen: NDArray[np.bool_]) -> BatchStep:
        actions = self.environments[0].action_type.checked(actions, (len(self), 2))
        for vector, rows in zip(self._vectors, self._rows, strict=True):
            vector.order_rows(actions[rows], chosen[rows])
        self._crew.drive([piece for vector in self._vectors for piece in vector.episodes.pieces])
        rewards = np.zeros(len(self), np.float32)
        terminated, truncated = np.zeros(len(self), np.bool_), np.zeros(len(self), np.bool_)
        infos = []
        for vector, rows in zip(self._vectors, self._rows, strict=True):
            results = vector.results_of_rows(chosen[rows])
            rewards[rows], terminated[rows], truncated[rows] = results[:3]
            infos.append(results[3])
        return BatchStep(rewards, terminated, truncated, common_infos(infos, self._rows, len(self)))

    def info(self, row: int) -> dict[str, Any]:
        """What `info` tells of one environment's last decision."""
        vector, place = self._places[row]
        return vector.episodes.info(place)

    def close(self) -> None:
        """Close the environments."""
        for vector in self._vectors:
            vector.close()
