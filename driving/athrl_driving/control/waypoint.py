"""The controller of a car that is given a target speed and a waypoint.

Frames and units are the ones of highway-env throughout: metres, seconds, m/s for target and measured speed
alike, and headings that grow clockwise as y points down, so a positive angle is to the driver's right.
"""

from __future__ import annotations

import math

from .pid import Pid

MAXIMUM_ACCELERATION = 3.0
"""Limit of accelerating and braking, m/s2."""

MAXIMUM_STEERING = 0.3
"""Limit of the steering command, a share of full lock as in CARLA."""

WHEEL_ANGLE_PER_STEERING = math.radians(70.0)
"""Angle of the front wheels for a steering command of 1, rad; the limit of 0.3 is 21 degrees."""

_GAINS = (0.7, 0.005, 0.001)
"""Proportional, derivative, integral; the authors' release has the same for both loops."""


def angle_in_frame(x: float, y: float, heading: float, target: tuple[float, float]) -> float:
    """Angle of `target` seen from a pose, rad in (-pi, pi], positive to the driver's right."""
    bearing = math.atan2(target[1] - y, target[0] - x)
    return math.remainder(bearing - heading, math.tau)


class WaypointController:
    """Speed and steering loop; both remember the past from tick to tick and from decision to decision."""

    def __init__(self) -> None:
        self.speed_loop = Pid(*_GAINS, limit=MAXIMUM_ACCELERATION)
        self.steering_loop = Pid(*_GAINS, limit=MAXIMUM_STEERING)

    def reset(self) -> None:
        """Begin an episode."""
        self.speed_loop.reset()
        self.steering_loop.reset()

    def acceleration(self, speed: float, target_speed: float, interval: float) -> float:
        """Acceleration towards the target speed, m/s2; both speeds in m/s."""
        return self.speed_loop.step(target_speed - speed, interval)

    def steering(
        self, x: float, y: float, heading: float, waypoint: tuple[float, float], interval: float
    ) -> float:
        """Steering command towards the waypoint, within +-MAXIMUM_STEERING, positive to the right.

        A waypoint that has been passed pulls no more: turning back to it would be no driving.
        """
        angle = angle_in_frame(x, y, heading, waypoint)
        if abs(angle) > math.pi / 2:
            angle = 0.0
        return self.steering_loop.step(angle, interval)
