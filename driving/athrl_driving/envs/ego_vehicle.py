"""The ego as a vehicle of highway-env whose numbers are stored in the state of an episode."""

from __future__ import annotations

import math

import numpy as np
from athrl_spaces import Limits
from highway_env.road.road import Road
from highway_env.utils import Vector
from highway_env.vehicle.graphics import VehicleGraphics
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from athrl_driving.control import WaypointController
from athrl_driving.episode.ego import (
    ACCELERATION,
    CONTROL_SIZE,
    EGO_LENGTH,
    EGO_WHEELBASE,
    EGO_WIDTH,
    SPEED_MEMORY,
    STEERING,
    STEERING_MEMORY,
    TARGET_SPEED,
    WAYPOINT_X,
    WAYPOINT_Y,
    WHEEL_ANGLE,
    control_ego,
    move_ego,
    place_ego,
)
from athrl_driving.traffic.ego_columns import EGO_SIZE, ELEVATION, HEADING, SPEED, X, Y


class EgoVehicle(Vehicle):
    """A car of 4.9 x 2.1 m that drives to a waypoint at a target speed.

    The motion is that of highway-env's `Vehicle` with two differences: the axles are where such a car has
    them and not at its bumpers, and brakes stop the car and do not push it backwards.

    `ego` float64 [8] and `control` float64 [10] are what kernels read and write (see `episode.ego`);
    `collision` int64 [1] is not 0 after a crash. A vehicle that is given no arrays has its own.
    """

    LENGTH = EGO_LENGTH
    WIDTH = EGO_WIDTH
    WHEELBASE = EGO_WHEELBASE
    """Distance between the axles, m; with 21 degrees of steering the centre turns with a radius of 7.6 m."""

    tick: float
    """Interval at which `act` is called, s."""

    def __init__(
        self,
        road: Road,
        position: Vector,
        heading: float = 0,
        speed: float = 0,
        predition_type: str = "constant_steering",
    ) -> None:
        ego, control = np.empty(EGO_SIZE), np.empty(CONTROL_SIZE)
        place_ego(ego, control, float(position[0]), float(position[1]), float(heading), 0.0)
        ego[SPEED] = speed
        self._take(road, ego, control, np.zeros(1, np.int64), predition_type)

    @classmethod
    def of_episode(
        cls,
        road: Road,
        ego: NDArray[np.float64],
        control: NDArray[np.float64],
        collision: NDArray[np.int64],
        *,
        tick: float,
        speed_gain: float,
    ) -> EgoVehicle:
        """Make the ego that these arrays describe; `tick` in s, `speed_gain` of its speed loop in 1/s."""
        vehicle = cls.__new__(cls)
        vehicle._take(road, ego, control, collision, "constant_steering", speed_gain)
        vehicle.tick = tick
        return vehicle

    def _take(
        self,
        road: Road,
        ego: NDArray[np.float64],
        control: NDArray[np.float64],
        collision: NDArray[np.int64],
        prediction_type: str,
        speed_gain: float = Limits.speed_gain,
    ) -> None:
        self._ego, self._control, self._collision = ego, control, collision
        state = ego.copy(), control.copy(), collision.copy()
        # highway-env would look for the nearest lane here and at every step; the environment knows the lane.
        super().__init__(None, (ego[X], ego[Y]), float(ego[HEADING]), float(ego[SPEED]), prediction_type)
        ego[:], control[:], collision[:] = state
        self.road = road
        self.color = VehicleGraphics.EGO_COLOR
        self.controller = WaypointController(
            control[SPEED_MEMORY : SPEED_MEMORY + 2],
            control[STEERING_MEMORY : STEERING_MEMORY + 2],
            speed_gain,
        )
        self.tick = 0.1

    @property
    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`ego` and `control`, for kernels."""
        return self._ego, self._control

    @property
    def position(self) -> NDArray[np.float64]:
        """float64 [2], m; a view: writing to it moves the ego."""
        return self._ego[X : Y + 1]

    @position.setter
    def position(self, value: Vector) -> None:
        self._ego[X], self._ego[Y] = value

    @property
    def heading(self) -> float:
        """Heading, rad."""
        return float(self._ego[HEADING])

    @heading.setter
    def heading(self, value: float) -> None:
        self._ego[HEADING] = value

    @property
    def speed(self) -> float:
        """Speed, m/s."""
        return float(self._ego[SPEED])

    @speed.setter
    def speed(self, value: float) -> None:
        self._ego[SPEED] = value

    @property
    def elevation(self) -> float:
        """Height of the road below the ego, m."""
        return float(self._ego[ELEVATION])

    @property
    def crashed(self) -> bool:
        """Whether the ego has hit something."""
        return bool(self._collision[0])

    @crashed.setter
    def crashed(self, value: bool) -> None:
        self._collision[0] = int(value)

    @property
    def steering(self) -> float:
        """Last steering command, within +-0.3, positive to the right."""
        return float(self._control[STEERING])

    @property
    def target_speed(self) -> float:
        """Speed of the last decision, m/s; NaN where acceleration and steering are decided."""
        return float(self._control[TARGET_SPEED])

    @property
    def waypoint(self) -> tuple[float, float] | None:
        """Point of the last decision in the world, m; None where acceleration and steering are decided."""
        x, y = float(self._control[WAYPOINT_X]), float(self._control[WAYPOINT_Y])
        return None if math.isnan(x) else (x, y)

    @property
    def action(self) -> dict[str, float]:
        """Angle of the front wheels (rad, positive to the right) and acceleration (m/s2), for highway-env."""
        return {
            "steering": float(self._control[WHEEL_ANGLE]),
            "acceleration": float(self._control[ACCELERATION]),
        }

    @action.setter
    def action(self, value: dict[str, float]) -> None:
        self._control[WHEEL_ANGLE], self._control[ACCELERATION] = value["steering"], value["acceleration"]

    def follow(self, target_speed: float, waypoint: tuple[float, float]) -> None:
        """Set target speed (m/s) and waypoint (m, in the world) until the next decision."""
        self._control[TARGET_SPEED] = target_speed
        self._control[WAYPOINT_X], self._control[WAYPOINT_Y] = waypoint

    def act(self, action: dict | str | None = None) -> None:
        """Run both controllers for one tick; without a waypoint the last commands hold.

        `action` sets acceleration and wheel angle directly instead.
        """
        if action is not None:
            super().act(action)
        else:
            control_ego(self._ego, self._control, self.controller.speed_loop.proportional, self.tick)

    def step(self, dt: float) -> None:
        """Move for `dt` seconds."""
        move_ego(self._ego, self._control, self.crashed, self.WHEELBASE, dt)
        self.on_state_update()

    def on_state_update(self) -> None:
        """Keep the history that highway-env's renderer may use; the environment sets the lane."""
        if self.road.record_history:
            self.history.appendleft(self.create_from(self))
