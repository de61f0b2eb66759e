"""A batch of environments that are stepped together, each reset with its own seed when required."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from athrl_spaces import PolicyDescription
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from athrl_driving.envs import EnvView, TownEnv, TownVectorEnv
from athrl_driving.envs.settings import action_setting, changed_settings
from athrl_driving.envs.vector_env import cores
from athrl_driving.episode import Workers, new_observation_arrays
from athrl_driving.errors import DrivingError
from athrl_driving.policy.infos import common_infos
from athrl_driving.policy.recording import Recording
from athrl_driving.policy.towns import environments_of_towns, ranks_within_towns


def environment_config(
    *,
    strict_map: bool,
    vehicles: int,
    image_size: int,
    episode_ticks: int,
    ticks_per_decision: int,
    maximum_speed: float,
    waypoint_radius: float,
    waypoint_half_angle: float,
    speed_gain: float,
) -> dict[str, Any]:
    """Return a town environment's config from plain settings; `waypoint_half_angle` is in degrees."""
    return {
        "strict_map": strict_map,
        "vehicles_count": vehicles,
        "image_size": image_size,
        "episode_ticks": episode_ticks,
        "ticks_per_decision": ticks_per_decision,
        "maximum_speed": maximum_speed,
        "waypoint_radius": waypoint_radius,
        "waypoint_half_angle": math.radians(waypoint_half_angle),
        "speed_gain": speed_gain,
    }


def config_of(description: PolicyDescription) -> dict[str, Any]:
    """Return the part of the config that a policy determines: image size, kind of action and its limits."""
    limits = description.limits
    return {
        "image_size": description.observation.image_size,
        "maximum_speed": limits.maximum_speed,
        "waypoint_radius": limits.waypoint_radius,
        "waypoint_half_angle": limits.waypoint_half_angle,
        "speed_gain": limits.speed_gain,
        "action": action_setting(description.action_kind),
    }


@dataclass(frozen=True)
class BatchStep:
    """Results of a step: rewards float32 [batch], ends bool [batch], and infos in gymnasium's vector format.

    Environments that were not stepped have zeros and False.
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
        images: uint8 [count, H, W, C]; it changes with every step. After a step that ended an episode an
            environment's image is that of the terminal observation until `reset` is called.
        motion: float32 [count, m] that belongs to the images.
        recording: observations and rewards since each environment's recording buffer was rewound.
        environments: each environment as an object, for drivers and viewers.
        towns: of each environment, as given.
        ranks: float64 [count], evenly from 0 to 1 among the environments of a town: how much each explores.
        action_kind: as given.

    Raises:
        ValueError: a town, a kind of action or a setting does not exist, or `towns` is empty; in one line.
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
        observations = new_observation_arrays(len(self.towns), int(image_size), recorded)
        self.images, self.motion = observations.images, observations.motion
        self.recording = Recording(observations.recording_buffer, self.images.shape[1:])
        self._env_indices = list(environments_of_towns(self.towns).values())
        self._workers = Workers(cores())
        self._vectors = [
            TownVectorEnv(
                len(indices),
                config=settings,
                map=self.towns[indices[0]],
                autoreset_mode=AutoresetMode.DISABLED,
                observations=observations._replace(env_index=indices),
                workers=self._workers,
            )
            for indices in self._env_indices
        ]
        self._places = {
            env_index: (vector, place)
            for vector, indices in zip(self._vectors, self._env_indices, strict=True)
            for place, env_index in enumerate(indices.tolist())
        }
        self.environments: list[EnvView] = [
            vector.environment(place) for vector, place in (self._places[e] for e in range(len(self)))
        ]

    def __len__(self) -> int:
        return len(self.towns)

    def __reduce__(self) -> tuple:
        """Raise DrivingError: its vectors share their memory, which copies of them would not."""
        raise DrivingError("a batch cannot be pickled: make another one from its towns and settings")

    def reset(self, env_index: int, seed: int) -> None:
        """Begin a new episode in one environment."""
        vector, place = self._places[env_index]
        vector.reset_environment(place, seed)

    def step(self, actions: NDArray[np.float32], active: NDArray[np.bool_] | None = None) -> BatchStep:
        """Make a decision in every environment, or only in those of `active` bool [count].

        Args:
            actions: float32 [count, 2]; within [-1, 1], or choices for the kind `waypoint-set`.
            active: the environments to step.

        Raises:
            DrivingError: an action is invalid; nothing has moved.
        """
        chosen = np.ones(len(self), np.bool_) if active is None else active
        if len(self._vectors) == 1:
            rewards, terminated, truncated, infos = self._vectors[0].step_environments(actions, chosen)
            return BatchStep(rewards.astype(np.float32), terminated, truncated, infos)
        return self._step_towns(actions, chosen)

    def _step_towns(self, actions: NDArray[np.float32], chosen: NDArray[np.bool_]) -> BatchStep:
        actions = self.environments[0].action_type.checked(actions, (len(self), 2))
        for vector, indices in zip(self._vectors, self._env_indices, strict=True):
            vector.order_step(actions[indices], chosen[indices])
        self._workers.drive([each for vector in self._vectors for each in vector.episodes.slices])
        rewards = np.zeros(len(self), np.float32)
        terminated, truncated = np.zeros(len(self), np.bool_), np.zeros(len(self), np.bool_)
        infos = []
        for vector, indices in zip(self._vectors, self._env_indices, strict=True):
            results = vector.step_results(chosen[indices])
            rewards[indices], terminated[indices], truncated[indices] = results[:3]
            infos.append(results[3])
        return BatchStep(rewards, terminated, truncated, common_infos(infos, self._env_indices, len(self)))

    def info(self, env_index: int) -> dict[str, Any]:
        """The `info` of one environment's last decision."""
        vector, place = self._places[env_index]
        return vector.episodes.info(place)

    def close(self) -> None:
        """Close the environments and end their threads."""
        for vector in self._vectors:
            vector.close()
        self._workers.close()
