"""The low level: PID controllers that turn a target speed and a waypoint into acceleration and steering."""

from .pid import Pid
from .waypoint import (
    MAXIMUM_ACCELERATION,
    MAXIMUM_STEERING,
    WHEEL_ANGLE_PER_STEERING,
    WaypointController,
    angle_in_frame,
)

__all__ = [
    "MAXIMUM_ACCELERATION",
    "MAXIMUM_STEERING",
    "WHEEL_ANGLE_PER_STEERING",
    "Pid",
    "WaypointController",
    "angle_in_frame",
]
