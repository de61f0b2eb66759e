"""One environment of a batch as an object, for drivers, viewers and tests."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces

from athrl_driving.envs.action import DirectAction, WaypointAction, WaypointSetAction, make_action
from athrl_driving.envs.ego_vehicle import EgoVehicle
from athrl_driving.envs.road import EpisodeRoad
from athrl_driving.episode import Episodes
from athrl_driving.episode.ego import ACCELERATION, WHEEL_ANGLE
from athrl_driving.reward import REWARD_TERMS
from athrl_driving.route import Route
from athrl_driving.scene import Scene, VehiclePose


class EnvView:
    """Environment `env_index` of `episodes`, in any of its episodes; `config` is the environment's."""

    def __init__(self, episodes: Episodes, env_index: int, config: Mapping[str, Any]) -> None:
        self.episodes = episodes
        self.env_index = env_index
        self.config = config
        self.town = episodes.town

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs; views of the arrays, like the route, are made again when used."""
        return {name: value for name, value in vars(self).items() if name not in ("route", "action_type")}

    @property
    def unwrapped(self) -> EnvView:
        """The view itself, as in gymnasium's environments."""
        return self

    @cached_property
    def road(self) -> EpisodeRoad:
        """The road with its vehicles."""
        return EpisodeRoad(self.episodes, self.env_index, record_history=self.config["show_trajectories"])

    @property
    def vehicle(self) -> EgoVehicle:
        """The ego."""
        ego: EgoVehicle = self.road.vehicles[0]
        lane_index = self.town.lane_indices[self.route.lane]
        if lane_index != ego.lane_index:
            ego.lane_index, ego.lane = lane_index, self.town.network.get_lane(lane_index)
        return ego

    @cached_property
    def route(self) -> Route:
        """The ego's route."""
        return Route.of_environment(self.town.graph, self.episodes.state.routes, self.env_index)

    @cached_property
    def action_type(self) -> WaypointAction | WaypointSetAction | DirectAction:
        """The action type, which says what the entries of an action mean."""
        return make_action(self)

    @cached_property
    def action_space(self) -> spaces.Space:
        """The action space of two entries."""
        return self.action_type.space()

    def scene(self) -> Scene:
        """The present moment, for a live view or a recording."""
        state, e = self.episodes.state.progress, self.env_index
        ego, others = self.vehicle, self.road.background
        columns = (others.x, others.y, others.heading, others.speed, others.length, others.width)
        x, y = ego.position.tolist()
        return Scene(
            step=int(state.decisions[e]),
            time=float(state.ticks[e]) * self.episodes.state.settings.interval,
            ego=VehiclePose(x, y, ego.heading, ego.speed, ego.LENGTH, ego.WIDTH),
            vehicles=tuple(VehiclePose(*row) for row in np.stack(columns, axis=1).tolist()),
            route=self.route.waypoints()[:, :2],
            waypoint=None if ego.waypoint is None else np.array(ego.waypoint),
            target_speed=ego.target_speed,
            steering=float(state.control[e, WHEEL_ANGLE]),
            acceleration=float(state.control[e, ACCELERATION]),
            reward=float(state.reward[e]),
            reward_terms=dict(zip(REWARD_TERMS, state.terms[e].tolist(), strict=True)),
        )
