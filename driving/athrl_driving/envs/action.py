"""The kinds of action: target speed and waypoint, the same out of a set, and acceleration and steering."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from athrl_spaces import WAYPOINT_SET, Discrete, Limits, action_kind
from athrl_spaces.action_kinds import MAXIMUM_ACCELERATION, MAXIMUM_STEERING
from gymnasium import spaces
from highway_env.envs.common.action import ActionType
from numpy.typing import NDArray

from athrl_driving.envs.ego_vehicle import EgoVehicle
from athrl_driving.envs.settings import drive_settings
from athrl_driving.episode.decision import take_decision
from athrl_driving.errors import DrivingError


class TownAction(ActionType):
    """One of the kinds of action; each has two entries.

    Attributes:
        maximum_speed: highest target speed, m/s.
    """

    def __init__(self, env: Any, **_: object) -> None:
        super().__init__(env)
        self.settings = drive_settings(env.config)
        self.maximum_speed = self.settings.maximum_speed

    @property
    def vehicle_class(self) -> Callable:
        """The class of the vehicle that carries the action out."""
        return EgoVehicle

    @classmethod
    @abstractmethod
    def checked(cls, actions: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return actions as contiguous float32 of `shape`, [2] or [environments, 2].

        Raises DrivingError in one line for anything else.
        """

    def act(self, action: Any) -> None:
        """Apply the action to the ego; raises DrivingError for an invalid one."""
        ego: EgoVehicle = self.controlled_vehicle
        take_decision(self.settings, *ego.arrays, self.checked(action, (2,)))


class _BoxAction(TownAction):
    """Box(-1, 1, (2,)), float32; an entry beyond a bound is taken as the bound."""

    def space(self) -> spaces.Box:
        """The action space, float32 [2]."""
        return spaces.Box(-1.0, 1.0, shape=(2,), dtype=np.float32)

    @classmethod
    def checked(cls, actions: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return actions as contiguous float32 of `shape`.

        Raises DrivingError for another shape, for anything but an array of numbers, and for NaN and infinity,
        which would spread through motion, reward and every later observation.
        """
        checked = _numbers(actions, shape, "float32")
        # In double precision a sum of finite single ones is finite; NumPy's isfinite().all() takes 3 us.
        if not math.isfinite(sum(checked.ravel().tolist())):
            _refuse(checked, np.isfinite(checked), "finite numbers in [-1, 1]")
        return checked


class WaypointAction(_BoxAction):
    """Target speed from 0 to `maximum_speed`, waypoint angle from -half to +half angle.

    The waypoint is `waypoint_radius` metres from the ego, at that angle to the right of its heading when the
    decision is made, and is fixed in the world until the next decision.
    """

    def normalised(self, target_speed: float, waypoint_angle: float) -> NDArray[np.float32]:
        """float32 [2] action of a target speed (m/s) and a waypoint angle (rad), clipped to the ranges."""
        return _clipped(
            2.0 * target_speed / self.maximum_speed - 1.0, waypoint_angle / self.settings.waypoint_half_angle
        )


class DirectAction(_BoxAction):
    """Acceleration from -3 to 3 m/s2, steering command from -0.3 to 0.3, positive to the right.

    Both hold until the next decision; no controller runs. A steering command of 0.3 turns the front wheels by
    21 degrees.
    """

    def normalised(self, acceleration: float, steering: float) -> NDArray[np.float32]:
        """float32 [2] action of an acceleration (m/s2) and a steering command, clipped to the ranges."""
        return _clipped(acceleration / MAXIMUM_ACCELERATION, steering / MAXIMUM_STEERING)


class WaypointSetAction(TownAction):
    """MultiDiscrete([3, 16]): a behaviour, which is a target speed, and a waypoint out of a set.

    The behaviours are to stop, to drive at half of `maximum_speed`, and to drive at `maximum_speed`.
    Waypoints 0 to 7 lie at half of `waypoint_radius`, from the left half angle to the right one; 8 to 15 lie
    likewise at the full radius.
    """

    choices: ClassVar[tuple[int, ...]] = tuple(
        len(action.choices)
        for action in action_kind(WAYPOINT_SET).describe(Limits())
        if isinstance(action, Discrete)
    )

    def space(self) -> spaces.MultiDiscrete:
        """The action space, int64 [2]."""
        return spaces.MultiDiscrete(list(self.choices))

    @classmethod
    def checked(cls, actions: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return actions as contiguous float32 of `shape`; whole numbers of any type are accepted.

        Raises DrivingError for another shape, for anything but an array of numbers, and for a choice that
        does not exist.
        """
        checked = _numbers(actions, shape, "whole numbers")
        exists = (checked >= 0) & (checked < cls.choices) & (checked == np.rint(checked))
        if not exists.all():
            behaviours, waypoints = cls.choices
            _refuse(
                checked,
                exists,
                f"a behaviour from 0 to {behaviours - 1} and a waypoint from 0 to {waypoints - 1}",
            )
        return checked


_TYPES: dict[str, type[WaypointAction | WaypointSetAction | DirectAction]] = {
    action.__name__: action for action in (WaypointAction, WaypointSetAction, DirectAction)
}


def make_action(env: Any) -> WaypointAction | WaypointSetAction | DirectAction:
    """The action type that the checked settings of an environment, `env.config`, name."""
    return _TYPES[env.config["action"]["type"]](env)


def _clipped(first: float, second: float) -> NDArray[np.float32]:
    return np.clip(np.array([first, second]), -1.0, 1.0).astype(np.float32)


def _numbers(actions: Any, shape: tuple[int, ...], what: str) -> NDArray[np.float32]:
    """Return numbers as contiguous float32 of `shape`; raises DrivingError for anything else."""
    try:
        given = np.asarray(actions)
        if given.dtype.kind not in "iuf":
            raise TypeError
        numbers = np.ascontiguousarray(given, dtype=np.float32)
    except (TypeError, ValueError, OverflowError):
        text = " ".join(repr(actions).split())
        raise DrivingError(f"the action is {text:.80}, it should be {what} {list(shape)}") from None
    if given.shape != shape:
        which = "action has" if len(shape) == 1 else "array of actions has"
        raise DrivingError(f"the {which} shape {given.shape}, it should be {shape}")
    return numbers


def _refuse(actions: NDArray[np.float32], fits: NDArray[np.bool_], expected: str) -> None:
    """Raise DrivingError that names the invalid actions and shows the first of them."""
    wrong = np.flatnonzero(~fits.reshape(-1, actions.shape[-1]).all(axis=1)).tolist()
    where = f" of environments {wrong}" if actions.ndim > 1 else ""
    first = actions.reshape(-1, actions.shape[-1])[wrong[0]].tolist()
    raise DrivingError(f"the action{where} is {first}, it should be {expected}")
