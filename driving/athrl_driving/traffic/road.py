"""A highway-env road whose background traffic is one compiled call a tick."""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from athrl_driving.maps import Town
from athrl_driving.traffic.collision import first_touched
from athrl_driving.traffic.ego_columns import (
    EGO_SIZE,
    ELEVATION,
    HEADING,
    LENGTH,
    PRESENT,
    SPEED,
    WIDTH,
    X,
    Y,
)
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import (
    NONE,
    Background,
    Traffic,
    environment_views,
    new_traffic,
)
from athrl_driving.traffic.tick import tick
from athrl_driving.traffic.vehicle import BackgroundVehicle


class TrafficRoad(Road):
    """A town's road with background traffic that keeps to the right of way at junctions.

    `vehicles[0]` is the ego, any highway-env vehicle, appended before `spawn_background` is called; the
    others are `BackgroundVehicle` objects over the arrays of `background`. Without an ego all vehicles are
    background.

    `ego_path` (int64, lanes of the lane graph that the ego will drive, the present one among the first) is
    set by the environment: the ego requests the movements on it like any other vehicle.

    `traffic` is existing arrays, of which the road shows one environment, or the number of vehicles for which
    the road makes its own arrays; `ValueError` if that is negative. `np_random` places the vehicles.
    """

    def __init__(
        self,
        town: Town,
        traffic: Traffic | int,
        environment: int = 0,
        np_random: np.random.Generator | None = None,
        record_history: bool = False,
    ) -> None:
        super().__init__(network=town.network, np_random=np_random, record_history=record_history)
        self.town = town
        self.arrays = new_traffic(town, 1, traffic) if isinstance(traffic, int) else traffic
        self.environment = environment
        self.traffic = environment_views(self.arrays, environment)
        self.ego_path: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._ego_state = np.zeros(EGO_SIZE)
        self.vehicles: list[Vehicle]

    @property
    def background(self) -> Background:
        """The arrays of the background vehicles."""
        return self.traffic.background

    def spawn_background(
        self, keep_clear_of: tuple[float, float] | None = None, clearance: float = 8.0
    ) -> None:
        """Place the background vehicles, no centre within `clearance` metres of the point `keep_clear_of`.

        Raises `ValueError` where the town has no room.
        """
        ego = self._observed_ego()
        place_vehicles(self.arrays, self.environment, self.np_random, keep_clear_of, clearance, ego)
        self.vehicles = [vehicle for vehicle in self.vehicles if not isinstance(vehicle, BackgroundVehicle)]
        self.vehicles += [BackgroundVehicle(self, index) for index in range(len(self.background.lane))]

    def act(self) -> None:
        """Let the ego act; the background decides within `step`."""
        if self._has_ego():
            self.vehicles[0].act()

    def step(self, dt: float) -> None:
        """Move all vehicles by `dt` seconds and note what the ego hits; traffic sees the ego's last place."""
        tick(self.arrays, self.environment, self._observed_ego(), self.ego_path, dt)
        if not self._has_ego():
            return
        ego = self.vehicles[0]
        ego.step(dt)
        touched = first_touched(self.background, self._observed_ego())
        if touched != NONE:
            ego.crashed = True
            self.background.crashed[touched] = True
        for obstacle in self.objects:
            ego.handle_collisions(obstacle, dt)

    def leader_of_ego(self) -> tuple[float, float]:
        """Return (gap m, speed m/s) of the next vehicle on `ego_path`, or (inf, 0).

        The gap is from bumper to bumper along the path.
        """
        tick(self.arrays, self.environment, self._observed_ego(), self.ego_path, 0.0)
        ego = len(self.background.lane)
        gap = float(self.traffic.scratch.gap[ego])
        return (gap, float(self.traffic.scratch.leader_speed[ego])) if math.isfinite(gap) else (math.inf, 0.0)

    def ego_may_enter(self) -> bool:
        """Tell whether the ego holds the next junction on its path, or none is near, as of the last tick."""
        right_of_way = self.traffic.right_of_way
        return bool(right_of_way.ahead[-1] == NONE or right_of_way.granted[-1] == right_of_way.ahead[-1])

    def ego_stop_line(self) -> float:
        """Return the distance (m) from the ego's front to its next junction, as of the last tick."""
        return float(self.traffic.right_of_way.line_distance[-1])

    def _has_ego(self) -> bool:
        return bool(self.vehicles) and not isinstance(self.vehicles[0], BackgroundVehicle)

    def _observed_ego(self) -> NDArray[np.float64]:
        state = self._ego_state
        state[PRESENT] = float(self._has_ego())
        if not self._has_ego():
            return state
        ego = self.vehicles[0]
        state[X], state[Y] = ego.position
        state[HEADING], state[SPEED] = ego.heading, ego.speed
        state[LENGTH], state[WIDTH] = ego.LENGTH, ego.WIDTH
        state[ELEVATION] = getattr(ego, "elevation", 0.0)
        return state
