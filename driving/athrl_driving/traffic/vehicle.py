"""A background vehicle as highway-env knows it: an object whose attributes read the arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

if TYPE_CHECKING:
    from athrl_driving.traffic.road import TrafficRoad


class BackgroundVehicle(IDMVehicle):
    """One row of the arrays. The road moves it; `act` and `step` do nothing, and its state is read only."""

    def __init__(self, road: TrafficRoad, row: int) -> None:
        # highway-env's constructors would look for the closest lane and copy the state: the arrays hold all.
        self.road = road
        self.row = row
        self.collidable = self.solid = True
        self.check_collisions = False
        self.hit = False
        self.impact = None
        self.enable_lane_change = False
        self.timer = 0.0
        self.route = None
        self.history: list[IDMVehicle] = []
        self.log: list[dict] = []

    @property
    def position(self) -> NDArray[np.float64]:
        """The centre, m."""
        background = self.road.background
        return np.array((background.x[self.row], background.y[self.row]))

    @property
    def heading(self) -> float:
        """Radians."""
        return float(self.road.background.heading[self.row])

    @property
    def speed(self) -> float:
        """Metres per second."""
        return float(self.road.background.speed[self.row])

    @property
    def target_speed(self) -> float:
        """The desired speed on a free road, m/s."""
        return float(self.road.background.desired_speed[self.row])

    @property
    def crashed(self) -> bool:
        """Whether the ego has hit it."""
        return bool(self.road.background.crashed[self.row])

    @property
    def action(self) -> dict[str, float]:
        """The acceleration of the last tick; on rails there is no steering."""
        return {"steering": 0.0, "acceleration": float(self.road.background.acceleration[self.row])}

    @property
    def lane_index(self) -> tuple[str, str, int]:
        """highway-env's index of the lane that it is on."""
        return self.road.town.lane_indices[self.road.background.lane[self.row]]

    @property
    def target_lane_index(self) -> tuple[str, str, int]:
        """The same lane: from the begin of a change it is on the new one."""
        return self.lane_index

    @property
    def lane(self) -> AbstractLane:
        """The lane that it is on."""
        return self.road.network.get_lane(self.lane_index)

    @property
    def LENGTH(self) -> float:  # noqa: N802
        """Metres."""
        return float(self.road.background.length[self.row])

    @property
    def WIDTH(self) -> float:  # noqa: N802
        """Metres."""
        return float(self.road.background.width[self.row])

    @property
    def diagonal(self) -> float:
        """Metres."""
        return float(np.hypot(self.LENGTH, self.WIDTH))

    def act(self, action: dict | str | None = None) -> None:
        """Do nothing: the road decides for all background vehicles at once."""

    def step(self, dt: float) -> None:
        """Do nothing: the road moves all background vehicles at once."""
