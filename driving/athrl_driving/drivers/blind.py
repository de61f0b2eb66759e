"""The driver that looks at nothing but its route."""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from athrl_driving.drivers.driver import Driver, town_of
from athrl_driving.drivers.pursuit import pursuit_angle
from athrl_driving.envs import TownRow


class BlindRouteFollower(Driver):
    """Pursues the route at a constant 4 m/s, whatever is in the way."""

    SPEED = 4.0
    """Target speed, m/s."""
    LOOK_AHEAD = 5.0
    """Distance of the pursued point along the route, m."""

    def act(self, env: gymnasium.Env | TownRow) -> NDArray[np.float32]:
        """Towards the route."""
        town = town_of(env)
        return town.action_type.normalised(self.SPEED, pursuit_angle(town, self.LOOK_AHEAD))
