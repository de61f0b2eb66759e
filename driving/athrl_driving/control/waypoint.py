"""The controller of a car with a target speed and a waypoint.

Frames and units are the ones of highway-env throughout: metres, seconds, m/s for target and measured speed
alike, and headings that grow clockwise as y points down, so a positive angle is to the driver's right.
"""

from __future__ import annotations

import math

import numpy as np
from athrl_spaces.action_kinds import MAXIMUM_ACCELERATION, MAXIMUM_STEERING, Limits
from numpy.typing import NDArray

from athrl_driving.control.pid import Pid, pid_step
from athrl_driving.kernels.compilation import compiled

WHEEL_ANGLE_PER_STEERING = math.radians(70.0)
"""Angle of the front wheels for a steering command of 1, rad; the limit of 0.3 is 21 degrees."""

BEHIND = math.radians(135.0)
"""Angle to a waypoint from which on it lies behind the car, rad."""

PROPORTIONAL, DERIVATIVE, INTEGRAL = 0.7, 0.005, 0.001
"""Gains of the steering loop, and the last two of the speed loop too, as in the authors' release."""


@compiled
def angle_to(x: float, y: float, heading: float, target_x: float, target_y: float) -> float:
    """Angle of a point seen from a pose, rad in (-pi, pi], positive to the driver's right."""
    dx, dy = target_x - x, target_y - y
    cosine, sine = math.cos(heading), math.sin(heading)
    return math.atan2(dy * cosine - dx * sine, dx * cosine + dy * sine)


@compiled
def acceleration_command(
    memory: NDArray[np.float64], speed: float, target_speed: float, gain: float, interval: float
) -> float:
    """Acceleration towards the target speed, m/s2.

    `memory` float64 [2] is the speed loop's, `gain` its proportional gain, 1/s.
    """
    error = target_speed - speed
    return pid_step(memory, gain, DERIVATIVE, INTEGRAL, MAXIMUM_ACCELERATION, error, interval)


@compiled
def steering_command(
    memory: NDArray[np.float64],
    x: float,
    y: float,
    heading: float,
    waypoint_x: float,
    waypoint_y: float,
    interval: float,
) -> float:
    """Steering command towards the waypoint, within +-MAXIMUM_STEERING, positive to the right.

    A waypoint that the car has passed counts as one beside it, until it lies behind the car (`BEHIND`): then
    it has no effect, as the car does not turn back. `memory` float64 [2] is the steering loop's.
    """
    angle = angle_to(x, y, heading, waypoint_x, waypoint_y)
    angle = 0.0 if abs(angle) > BEHIND else min(max(angle, -math.pi / 2), math.pi / 2)
    return pid_step(memory, PROPORTIONAL, DERIVATIVE, INTEGRAL, MAXIMUM_STEERING, angle, interval)


def angle_in_frame(x: float, y: float, heading: float, target: tuple[float, float]) -> float:
    """Angle of `target` seen from a pose, rad in (-pi, pi], positive to the driver's right."""
    return angle_to(float(x), float(y), float(heading), float(target[0]), float(target[1]))


class WaypointController:
    """Speed and steering loop; both keep their memory from tick to tick and from decision to decision.

    `speed_memory` and `steering_memory`, float64 [2], are their memories, `speed_gain` is the proportional
    gain of the speed loop, 1/s.
    """

    def __init__(
        self,
        speed_memory: NDArray[np.float64] | None = None,
        steering_memory: NDArray[np.float64] | None = None,
        speed_gain: float = Limits.speed_gain,
    ) -> None:
        rest = (DERIVATIVE, INTEGRAL)
        self.speed_loop = Pid(speed_gain, *rest, limit=MAXIMUM_ACCELERATION, memory=speed_memory)
        self.steering_loop = Pid(PROPORTIONAL, *rest, limit=MAXIMUM_STEERING, memory=steering_memory)

    def reset(self) -> None:
        """Begin an episode."""
        self.speed_loop.reset()
        self.steering_loop.reset()

    def acceleration(self, speed: float, target_speed: float, interval: float) -> float:
        """Acceleration towards the target speed, m/s2; both speeds in m/s."""
        loop = self.speed_loop
        return acceleration_command(
            loop.memory, float(speed), float(target_speed), loop.proportional, interval
        )

    def steering(
        self, x: float, y: float, heading: float, waypoint: tuple[float, float], interval: float
    ) -> float:
        """Steering command towards the waypoint; see `steering_command`."""
        place = (float(x), float(y), float(heading), float(waypoint[0]), float(waypoint[1]))
        return steering_command(self.steering_loop.memory, *place, interval)
