"""A background vehicle as highway-env knows it: an object whose attributes read the arrays."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from athrl_driving.maps import Town
from athrl_driving.traffic.state import Background


class BackgroundRoad(Protocol):
    """What a background vehicle reads of its road."""

    town: Town
    network: RoadNetwork

    @property
    def background(self) -> Background:
        """The arrays of all background vehicles."""


class BackgroundVehicle(IDMVehicle):
    """A view of one background vehicle, which the road moves: `act` and `step` do nothing.

    Its state is read only. `index` is its index in the arrays.
    """

    def __init__(self, road: BackgroundRoad, index: int) -> None:
        # highway-env's constructors would search the closest lane and copy the state, which the arrays hold.
        self.road = road
        self.index = index
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
        return np.array((background.x[self.index], background.y[self.index]))

    @property
    def heading(self) -> float:
        """Radians."""
        return float(self.road.background.heading[self.index])

    @property
    def speed(self) -> float:
        """Metres per second."""
        return float(self.road.background.speed[self.index])

    @property
    def target_speed(self) -> float:
        """The desired speed on a free road, m/s."""
        return float(self.road.background.desired_speed[self.index])

    @property
    def crashed(self) -> bool:
        """Whether the ego has hit it."""
        return bool(self.road.background.crashed[self.index])

    @property
    def action(self) -> dict[str, float]:
        """The acceleration of the last tick; as vehicles follow their lanes, there is no steering."""
        return {"steering": 0.0, "acceleration": float(self.road.background.acceleration[self.index])}

    @property
    def lane_index(self) -> tuple[str, str, int]:
        """highway-env's index of the lane that it is on."""
        return self.road.town.lane_indices[self.road.background.lane[self.index]]

    @property
    def target_lane_index(self) -> tuple[str, str, int]:
        """The same lane: from the start of a change the vehicle counts as on the new one."""
        return self.lane_index

    @property
    def lane(self) -> AbstractLane:
        """The lane that it is on."""
        return self.road.network.get_lane(self.lane_index)

    @property
    def LENGTH(self) -> float:  # noqa: N802
        """Metres."""
        return float(self.road.background.length[self.index])

    @property
    def WIDTH(self) -> float:  # noqa: N802
        """Metres."""
        return float(self.road.background.width[self.index])

    @property
    def diagonal(self) -> float:
        """Metres."""
        return float(np.hypot(self.LENGTH, self.WIDTH))

    def act(self, action: dict | str | None = None) -> None:
        """Do nothing: the road decides for all background vehicles at once."""

    def step(self, dt: float) -> None:
        """Do nothing: the road moves all background vehicles at once."""
