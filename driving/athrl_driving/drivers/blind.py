"""A driver that observes only its route."""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from athrl_driving.drivers.driver import Driver, town_of
from athrl_driving.drivers.pursuit import pursuit_angle
from athrl_driving.envs import EnvView


class BlindRouteFollower(Driver):
    """Follows the route at a constant 4 m/s and ignores all obstacles."""

    SPEED = 4.0
    """Target speed, m/s."""
    LOOK_AHEAD = 5.0
    """Distance of the pursued point along the route, m."""

    def act(self, env: gymnasium.Env | EnvView) -> NDArray[np.float32]:
        """Steer towards the route."""
        town = town_of(env)
        return town.action_type.normalised(self.SPEED, pursuit_angle(town, self.LOOK_AHEAD))
