"""The driver that a learned policy has to beat: keeps its distance, keeps to the route, gives way."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
from numpy.typing import NDArray

from ..envs import TownEnv
from .driver import Driver, town_of
from .pursuit import pursuit_angle


class RuleBasedDriver(Driver):
    """The intelligent driver model towards its leader and its stop line, pure pursuit of the route.

    It enters a junction only with the right of way that the road grants.
    """

    COMFORTABLE_ACCELERATION = 2.0
    """m/s2"""
    COMFORTABLE_BRAKING = 2.0
    """m/s2"""
    HEADWAY = 1.2
    """Time kept to the leader, s."""
    STANDSTILL_GAP = 2.5
    """Distance kept to a standing leader or to the stop line, m."""
    BEND_BRAKING = 1.5
    """Braking towards a bend, m/s2."""
    LATERAL_ACCELERATION = 2.5
    """Bound in bends, m/s2."""

    def act(self, env: gymnasium.Env) -> NDArray[np.float32]:
        """Towards the route, as fast as what lies ahead allows."""
        town = town_of(env)
        speed = town.vehicle.speed
        acceleration = self._acceleration(town)
        gain = town.vehicle.controller.speed_loop.proportional
        return town.action_type.normalised(
            speed + acceleration / gain, pursuit_angle(town, self._look_ahead(speed))
        )

    def _look_ahead(self, speed: float) -> float:
        """Distance of the pursued point along the route, m."""
        return 4.0 + 0.4 * speed

    def _acceleration(self, env: TownEnv) -> float:
        """What the most pressing of leader, stop line and free road asks for, m/s2."""
        speed = env.vehicle.speed
        gap, leader_speed = env.road.leader_of_ego()
        acceleration = self._towards(speed, self._desired_speed(env), gap, leader_speed)
        if not env.road.ego_may_enter():
            line = env.road.ego_stop_line()
            acceleration = min(acceleration, self._towards(speed, env.action_type.maximum_speed, line, 0.0))
        return acceleration

    def _towards(self, speed: float, desired_speed: float, gap: float, leader_speed: float) -> float:
        """Acceleration of the intelligent driver model, m/s2."""
        braking = 2.0 * math.sqrt(self.COMFORTABLE_ACCELERATION * self.COMFORTABLE_BRAKING)
        wanted = self.STANDSTILL_GAP + max(
            0.0, speed * self.HEADWAY + speed * (speed - leader_speed) / braking
        )
        share = wanted / max(gap, 0.1)
        return self.COMFORTABLE_ACCELERATION * (1.0 - (speed / desired_speed) ** 4 - share**2)

    def _desired_speed(self, env: TownEnv) -> float:
        """Speed that the bends of the next metres allow, m/s."""
        route, graph = env.route, env.town.graph
        desired = env.action_type.maximum_speed
        for index in range(route.index, route.lanes.size):
            distance = max(route.starts[index] - route.position, 0.0)
            curvature = abs(graph.curvature[route.lanes[index]])
            if distance > 30.0:
                break
            if curvature > 0.0:
                bend_speed = math.sqrt(self.LATERAL_ACCELERATION / curvature)
                desired = min(desired, math.sqrt(bend_speed**2 + 2.0 * self.BEND_BRAKING * distance))
        return desired
