"""The observation: the image of the surroundings and the ego's own motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.observation import ObservationType
from numpy.typing import NDArray

from ..control import MAXIMUM_STEERING
from ..perception import CHANNELS, Perception, drivable_map
from ..reward import FAST_SPEED

if TYPE_CHECKING:
    from .town_env import TownEnv

MOTION_LIMIT = 2.0
"""Bound of both entries of `motion`."""


class BirdEyeObservation(ObservationType):
    """`image` uint8 [size, size, 4], and `motion` float32 [2]: speed / 8 m/s, steering command / 0.3."""

    def __init__(self, env: TownEnv, **_: object) -> None:
        super().__init__(env)
        self.image_size = int(env.config["image_size"])
        town = env.town
        self.perception = Perception(drivable_map(town.name), town.graph, self.image_size)

    def space(self) -> spaces.Dict:
        """The observation space."""
        shape = (self.image_size, self.image_size, len(CHANNELS))
        return spaces.Dict(
            {
                "image": spaces.Box(0, 255, shape=shape, dtype=np.uint8),
                "motion": spaces.Box(-MOTION_LIMIT, MOTION_LIMIT, shape=(2,), dtype=np.float32),
            }
        )

    def observe(self) -> dict[str, NDArray]:
        """See the present moment; new arrays at each call."""
        env, ego = self.env, self.observer_vehicle
        x, y = float(ego.position[0]), float(ego.position[1])
        image = self.perception.observe(x, y, ego.heading, env.road.background, env.route)
        motion = np.array([ego.speed / FAST_SPEED, ego.steering / MAXIMUM_STEERING], dtype=np.float32)
        return {"image": image, "motion": np.clip(motion, -MOTION_LIMIT, MOTION_LIMIT)}
