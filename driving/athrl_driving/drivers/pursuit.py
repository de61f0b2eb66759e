"""Pure pursuit of the route, expressed as the waypoint angle for the steering loop."""

from __future__ import annotations

import math

import numpy as np

from athrl_driving.control import WHEEL_ANGLE_PER_STEERING, angle_in_frame
from athrl_driving.drivers.driver import DrivenTown


def pursuit_angle(env: DrivenTown, distance: float) -> float:
    """Waypoint angle (rad, positive to the right) that leads the ego to the route `distance` metres ahead.

    The circle through the ego and that point has a curvature; the bicycle model converts it to a wheel angle,
    and the steering loop's gain converts that to the waypoint angle.
    """
    ego, route = env.vehicle, env.route
    x, y = float(ego.position[0]), float(ego.position[1])
    goal_x, goal_y, _ = route.poses(np.array([route.position + distance]))[0]
    angle = angle_in_frame(x, y, ego.heading, (float(goal_x), float(goal_y)))
    curvature = 2.0 * math.sin(angle) / math.hypot(goal_x - x, goal_y - y)
    slip = math.asin(min(max(curvature * ego.WHEELBASE / 2.0, -0.9), 0.9))
    wheel_angle = math.atan(2.0 * math.tan(slip))
    return wheel_angle / WHEEL_ANGLE_PER_STEERING / ego.controller.steering_loop.proportional
