"""How an action sets the ego's targets or commands, compiled: one function for each kind of action."""

import math

import numpy as np
from athrl_spaces import ACTION_KINDS, DIRECT, WAYPOINT_SET
from athrl_spaces.action_kinds import BEHAVIOURS, DIRECTIONS, RADII, waypoint_directions
from numpy.typing import NDArray

from athrl_driving.control import MAXIMUM_ACCELERATION, MAXIMUM_STEERING, WHEEL_ANGLE_PER_STEERING
from athrl_driving.episode.ego import (
    ACCELERATION,
    STEERING,
    TARGET_SPEED,
    WAYPOINT_X,
    WAYPOINT_Y,
    WHEEL_ANGLE,
)
from athrl_driving.episode.state import DriveSettings
from athrl_driving.kernels.compilation import compiled, part
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.traffic.ego_columns import HEADING, X, Y

KIND_NUMBERS = {kind: number for number, kind in enumerate(ACTION_KINDS)}
"""Number of each kind of action in `DriveSettings`."""

_WAYPOINT_SET, _DIRECT = KIND_NUMBERS[WAYPOINT_SET], KIND_NUMBERS[DIRECT]
_SPEED_SHARES = tuple(BEHAVIOURS.values())
_RADIUS_SHARES = RADII
_ANGLE_SHARES = waypoint_directions(1.0)


@compiled
def take_decision(settings: DriveSettings, ego: Floats, control: Floats, action: NDArray[np.float32]) -> None:
    """Entry point for Python of `take`."""
    take(settings, ego, control, action)


@part
def take(settings: DriveSettings, ego: Floats, control: Floats, action: NDArray[np.float32]) -> None:
    """Apply an action, float32 [2] of the settings' kind: normalised (clipped to [-1, 1]), or choices."""
    if settings.action_kind == _DIRECT:
        _command(control, action)
    elif settings.action_kind == _WAYPOINT_SET:
        _choose_waypoint(settings, ego, control, action)
    else:
        speed = min(max(float(action[0]), -1.0), 1.0)
        angle = min(max(float(action[1]), -1.0), 1.0)
        _aim(settings, ego, control, (speed + 1.0) / 2.0, angle, 1.0)


@part
def forget_aim(settings: DriveSettings, control: Floats) -> None:
    """Clear the target where commands are given directly."""
    if settings.action_kind == _DIRECT:
        control[TARGET_SPEED] = control[WAYPOINT_X] = control[WAYPOINT_Y] = math.nan


@part
def _aim(
    settings: DriveSettings, ego: Floats, control: Floats, speed: float, angle: float, radius: float
) -> None:
    """Set a target speed and a waypoint in the world, each given as a share of the maximum."""
    control[TARGET_SPEED] = speed * settings.maximum_speed
    direction = ego[HEADING] + angle * settings.waypoint_half_angle
    distance = radius * settings.waypoint_radius
    control[WAYPOINT_X] = ego[X] + distance * math.cos(direction)
    control[WAYPOINT_Y] = ego[Y] + distance * math.sin(direction)


@part
def _choose_waypoint(
    settings: DriveSettings, ego: Floats, control: Floats, action: NDArray[np.float32]
) -> None:
    """Apply a behaviour and one of the waypoints of the set."""
    behaviour, waypoint = int(action[0]), int(action[1])
    radius, angle = _RADIUS_SHARES[waypoint // DIRECTIONS], _ANGLE_SHARES[waypoint % DIRECTIONS]
    _aim(settings, ego, control, _SPEED_SHARES[behaviour], angle, radius)


@part
def _command(control: Floats, action: NDArray[np.float32]) -> None:
    """Set acceleration and steering until the next decision; the controllers have no target."""
    control[TARGET_SPEED] = control[WAYPOINT_X] = control[WAYPOINT_Y] = math.nan
    control[ACCELERATION] = min(max(float(action[0]), -1.0), 1.0) * MAXIMUM_ACCELERATION
    control[STEERING] = min(max(float(action[1]), -1.0), 1.0) * MAXIMUM_STEERING
    control[WHEEL_ANGLE] = control[STEERING] * WHEEL_ANGLE_PER_STEERING
