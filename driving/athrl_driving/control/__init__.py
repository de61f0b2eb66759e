"""Low-level PID controllers that convert a target speed and a waypoint to acceleration and steering."""

from athrl_spaces.action_kinds import MAXIMUM_ACCELERATION, MAXIMUM_STEERING

from athrl_driving.control.pid import Pid
from athrl_driving.control.waypoint import (
    WHEEL_ANGLE_PER_STEERING,
    WaypointController,
    acceleration_command,
    angle_in_frame,
    steering_command,
)

__all__ = [
    "MAXIMUM_ACCELERATION",
    "MAXIMUM_STEERING",
    "WHEEL_ANGLE_PER_STEERING",
    "Pid",
    "WaypointController",
    "acceleration_command",
    "angle_in_frame",
    "steering_command",
]
