"""The action: a target speed and the direction of a waypoint."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.action import ActionType
from numpy.typing import NDArray

from athrl_driving.envs.ego_vehicle import EgoVehicle
from athrl_driving.envs.settings import drive_settings
from athrl_driving.episode.drive import take_decision
from athrl_driving.errors import DrivingError


class WaypointAction(ActionType):
    """Box(-1, 1, (2,)): target speed from 0 to `maximum_speed`, waypoint angle from -half to +half angle.

    The waypoint lies at `waypoint_radius` metres from the ego, at that angle to the right of its heading when
    the decision is made, and stays where it is in the world until the next decision.
    """

    def __init__(self, env: Any, **_: object) -> None:
        super().__init__(env)
        self.settings = drive_settings(env.config)
        self.maximum_speed = self.settings.maximum_speed
        self.radius = self.settings.waypoint_radius
        self.half_angle = self.settings.waypoint_half_angle

    def space(self) -> spaces.Box:
        """The action space, float32 [2]."""
        return spaces.Box(-1.0, 1.0, shape=(2,), dtype=np.float32)

    @property
    def vehicle_class(self) -> Callable:
        """The vehicle that can carry the action out."""
        return EgoVehicle

    def normalised(self, target_speed: float, waypoint_angle: float) -> NDArray[np.float32]:
        """float32 [2] action of a target speed (m/s) and a waypoint angle (rad), clipped to the ranges."""
        action = np.array([2.0 * target_speed / self.maximum_speed - 1.0, waypoint_angle / self.half_angle])
        return np.clip(action, -1.0, 1.0).astype(np.float32)

    def act(self, action: NDArray[np.floating]) -> None:
        """Hand the decision to the ego."""
        ego: EgoVehicle = self.controlled_vehicle
        take_decision(self.settings, *ego.arrays, np.asarray(action, np.float32))


def checked_actions(actions: NDArray[np.floating], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return decisions as float32 of `shape`, contiguous; one beyond [-1, 1] is taken as the nearest bound.

    Raises DrivingError for another shape, for what is no array of numbers, and for NaN and infinity, which
    would spread through motion, reward and every later observation.
    """
    try:
        checked = np.ascontiguousarray(actions, dtype=np.float32)
    except (TypeError, ValueError):
        raise DrivingError(f"the action is {actions!r}, it should be float32 {list(shape)}") from None
    if checked.shape != shape:
        what = "action has" if len(shape) == 1 else "array of actions has"
        raise DrivingError(f"the {what} shape {checked.shape}, it should be {shape}")
    # In double precision a sum of finite single ones is finite; NumPy's isfinite().all() takes 3 us.
    if not math.isfinite(sum(checked.ravel().tolist())):
        finite = np.isfinite(checked)
        rows = np.flatnonzero(~finite.reshape(-1, shape[-1]).all(axis=1)).tolist()
        where = f" of environments {rows}" if len(shape) > 1 else ""
        wrong = checked.reshape(-1, shape[-1])[rows[0]].tolist()
        raise DrivingError(f"the action{where} is {wrong}, it should be finite numbers in [-1, 1]")
    return checked
