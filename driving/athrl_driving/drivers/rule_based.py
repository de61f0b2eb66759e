"""The driver that a learned policy has to beat: it keeps its distance, follows the route and gives way."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
from numpy.typing import NDArray

from athrl_driving.drivers.car_following import following_acceleration, is_safe_behind
from athrl_driving.drivers.driver import DrivenTown, Driver, town_of
from athrl_driving.drivers.lane_change import next_lane_change
from athrl_driving.drivers.pursuit import pursuit_angle
from athrl_driving.envs import EnvView
from athrl_driving.route import CURVATURE


class RuleBasedDriver(Driver):
    """The intelligent driver model for its leader and its stop line, and pure pursuit of the route.

    It enters a junction only with the right of way that the road grants, at traffic lights only at green, and
    changes lanes only into a gap in which no vehicle has to brake hard.
    """

    BEND_BRAKING = 1.5
    """Braking towards a bend, m/s2."""
    LATERAL_ACCELERATION = 2.5
    """Bound in bends, m/s2."""

    def act(self, env: gymnasium.Env | EnvView) -> NDArray[np.float32]:
        """Follow the route, as fast as traffic, junctions and bends ahead allow."""
        town = town_of(env)
        target_speed = _target_speed(town, self._acceleration(town))
        angle = pursuit_angle(town, self._look_ahead(town.vehicle.speed))
        return town.action_type.normalised(target_speed, angle)

    def _look_ahead(self, speed: float) -> float:
        """Distance of the pursued point along the route, m."""
        return 4.0 + 0.4 * speed

    def _acceleration(self, env: DrivenTown) -> float:
        """The smallest acceleration of those for leader, stop line, lane change and free road, m/s2."""
        speed, maximum = env.vehicle.speed, env.action_type.maximum_speed
        gap, leader_speed = env.road.leader_of_ego()
        acceleration = following_acceleration(speed, self._desired_speed(env), gap, leader_speed)
        if not env.road.ego_may_enter():
            line = env.road.ego_stop_line()
            acceleration = min(acceleration, following_acceleration(speed, maximum, line, 0.0))
        return min(acceleration, self._for_lane_change(env))

    def _for_lane_change(self, env: DrivenTown) -> float:
        """The acceleration that the next lane change of the route allows, m/s2; inf without one."""
        change = next_lane_change(env)
        if change is None:
            return math.inf
        speed, maximum = env.vehicle.speed, env.action_type.maximum_speed
        under_way = change.distance < 0.0
        is_free = is_safe_behind(change.gap_ahead, speed, change.speed_ahead) and is_safe_behind(
            change.gap_behind, change.speed_behind, speed
        )
        if under_way or is_free:
            return following_acceleration(speed, maximum, change.gap_ahead, change.speed_ahead)
        # The target lane is occupied: the ego stays in its lane until there is a gap.
        return following_acceleration(speed, maximum, change.distance, 0.0)

    def _desired_speed(self, env: DrivenTown) -> float:
        """Speed that the bends of the next 30 metres allow, m/s."""
        route = env.route
        desired = env.action_type.maximum_speed
        for segment, start in zip(route.segments[route.index :], route.starts[route.index :], strict=False):
            distance = max(float(start) - route.position, 0.0)
            if distance > 30.0:
                break
            curvature = abs(float(segment[CURVATURE]))
            if curvature > 0.0:
                bend_speed = math.sqrt(self.LATERAL_ACCELERATION / curvature)
                desired = min(desired, math.sqrt(bend_speed**2 + 2.0 * self.BEND_BRAKING * distance))
        return desired


def _target_speed(env: DrivenTown, acceleration: float) -> float:
    """Target speed with which the ego accelerates by as much on average until the next decision, m/s.

    The speed loop asks for `gain` times what is missing, which gets less while the speed changes.
    """
    gain = env.vehicle.controller.speed_loop.proportional
    interval = env.config["ticks_per_decision"] / env.config["simulation_frequency"]
    return env.vehicle.speed + acceleration * interval / -math.expm1(-gain * interval)
