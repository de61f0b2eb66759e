"""The observation: the image of the surroundings and the ego's own motion."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from athrl_spaces import MOTION, Observation
from gymnasium import spaces
from highway_env.envs.common.observation import ObservationType
from numpy.typing import NDArray

from athrl_driving.episode import Episodes
from athrl_driving.episode.motion import MOTION_LIMIT


class ObservedEnv(Protocol):
    """What an observation reads of its environment."""

    config: dict[str, Any]
    episodes: Episodes


def observation_space(image_size: int) -> spaces.Dict:
    """`image` uint8 [size, size, 4], and `motion` float32 [2]: speed / 8 m/s, steering command / 0.3."""
    shape = Observation(image_size).image_shape
    return spaces.Dict(
        {
            "image": spaces.Box(0, 255, shape=shape, dtype=np.uint8),
            "motion": spaces.Box(-MOTION_LIMIT, MOTION_LIMIT, shape=(len(MOTION),), dtype=np.float32),
        }
    )


class BirdEyeObservation(ObservationType):
    """The observation that the kernel has drawn; see `observation_space`."""

    def __init__(self, env: ObservedEnv, **_: object) -> None:
        super().__init__(env)
        self.image_size = int(env.config["image_size"])

    def space(self) -> spaces.Dict:
        """The observation space."""
        return observation_space(self.image_size)

    def observe(self) -> dict[str, NDArray]:
        """Return the present observation in new arrays."""
        observations = self.env.episodes.state.observations
        return {"image": observations.images[0].copy(), "motion": observations.motion[0].copy()}
