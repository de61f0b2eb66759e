"""Driving through a town with traffic: one decision every four ticks, the paper's reward and endings."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from numpy.typing import NDArray

from ..maps import Town, lane_pose, load_town
from ..reward import REWARD_TERMS, has_left_lane, tick_reward_terms
from ..route import Route
from ..scene import Scene, VehiclePose
from ..traffic import TrafficRoad
from .action import WaypointAction
from .ego_vehicle import EgoVehicle
from .observation import BirdEyeObservation
from .settings import check_settings


class TownEnv(AbstractEnv):
    """The paper's task: an episode ends at the tick of a collision or of leaving the lane, or after 500."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["human", "rgb_array"], "render_fps": 5}

    @classmethod
    def default_config(cls) -> dict:
        """All settings with their defaults."""
        config = super().default_config()
        config.update(
            {
                "observation": {"type": "BirdEyeObservation"},
                "action": {"type": "WaypointAction"},
                "town": "town03",
                "vehicles_count": 100,  # background vehicles
                "image_size": 32,  # [px] height and width of the observation's image
                "episode_ticks": 500,
                "ticks_per_decision": 4,
                "simulation_frequency": 10,  # [Hz]
                "maximum_speed": 7.95,  # [m/s] highest target speed; above 8 m/s every tick costs
                "waypoint_radius": 8.0,  # [m]
                "waypoint_half_angle": np.pi / 6,  # [rad]
                "screen_width": 600,  # [px]
                "screen_height": 600,  # [px]
                "centering_position": [0.5, 0.5],
                "scaling": 6.0,
            }
        )
        return config

    def configure(self, config: dict | None) -> None:
        """Take settings; raises ValueError that names a key that does not exist or a value that cannot be."""
        super().configure(config)
        check_settings(self.config, self.default_config())
        self.config["policy_frequency"] = (
            self.config["simulation_frequency"] / self.config["ticks_per_decision"]
        )
        self.town: Town = load_town(self.config["town"])
        self._spaces_are_current = False

    def define_spaces(self) -> None:
        """Make observation and action; unlike in highway-env they last, with their seeds, over resets."""
        if self._spaces_are_current:
            return
        self.observation_type = BirdEyeObservation(self)
        self.action_type = WaypointAction(self)
        self.observation_space = self.observation_type.space()
        self.action_space = self.action_type.space()
        self._spaces_are_current = True

    def _reset(self) -> None:
        # A generator for each part, so that the ego's route does not depend on how much traffic there is.
        spawn_seed, route_seed, traffic_seed = self.np_random.integers(2**63, size=3)
        self._create_road(np.random.default_rng(traffic_seed))
        self._create_vehicles(np.random.default_rng(spawn_seed), np.random.default_rng(route_seed))
        self.decisions = 0
        self.distance = 0.0
        self._begin_decision()

    def _create_road(self, generator: np.random.Generator) -> None:
        self.road = TrafficRoad(
            self.town,
            self.config["vehicles_count"],
            np_random=generator,
            record_history=self.config["show_trajectories"],
        )

    def _create_vehicles(self, spawn: np.random.Generator, turns: np.random.Generator) -> None:
        """Put the ego at a random point of an ordinary lane, standing, and traffic everywhere else."""
        graph = self.town.graph
        margin = EgoVehicle.LENGTH
        room = np.where(graph.junction < 0, np.maximum(graph.length - 2 * margin, 0.0), 0.0)
        lane = int(spawn.choice(room.size, p=room / room.sum()))
        position = margin + spawn.uniform(0.0, room[lane])
        x, y, heading = lane_pose(graph, lane, position)
        ego = EgoVehicle(self.road, [x, y], heading, speed=0.0)
        ego.tick = 1.0 / self.config["simulation_frequency"]
        self.controlled_vehicles = [ego]
        self.road.vehicles.insert(0, ego)
        self.route = Route(graph, lane, position, turns)
        self._share_route()
        self.road.spawn_background(keep_clear_of=(x, y))

    def _share_route(self) -> None:
        """Tell the road where the ego is going, so that it can reserve junctions for it."""
        self.road.ego_path = self.route.lanes_ahead
        self.vehicle.lane_index = self.town.lane_indices[self.route.lane]
        self.vehicle.lane = self.town.network.get_lane(self.vehicle.lane_index)

    def _begin_decision(self) -> None:
        self._terms = dict.fromkeys(REWARD_TERMS, 0.0)
        self._ticks = 0
        self._metres = 0.0

    def _simulate(self, action: NDArray[np.floating] | None = None) -> None:
        """Let a decision hold for its ticks or until the episode ends, and sum the rewards of the ticks."""
        self._begin_decision()
        if action is not None:
            self.action_type.act(action)
        interval = self.vehicle.tick
        for tick in range(self.config["ticks_per_decision"]):
            if tick:
                self._automatic_rendering()
            self.road.act()
            self.road.step(interval)
            self.steps += 1
            self._end_tick(interval)
            if self._is_terminated() or self._is_truncated():
                break
        self.time = self.steps * interval
        self.decisions += 1
        self.enable_auto_render = False

    def _end_tick(self, interval: float) -> None:
        """Find the ego on its route and add up the tick."""
        ego = self.vehicle
        if self.route.advance(float(ego.position[0]), float(ego.position[1])):
            self._share_route()
        terms = tick_reward_terms(
            collision=bool(ego.crashed),
            speed=ego.speed,
            heading_error=ego.heading - self.route.heading_of_nearest_waypoint(),
            lateral_offset=self.route.lateral,
            steering=ego.steering,
        )
        for name, value in terms.items():
            self._terms[name] += value
        self._ticks += 1
        self._metres += ego.speed * interval
        self.distance += ego.speed * interval

    def _rewards(self, action: NDArray[np.floating]) -> dict[str, float]:
        return dict(self._terms)

    def _reward(self, action: NDArray[np.floating]) -> float:
        return sum(self._terms.values())

    def _is_terminated(self) -> bool:
        return bool(self.vehicle.crashed) or has_left_lane(self.route.lateral)

    def _is_truncated(self) -> bool:
        return self.steps >= self.config["episode_ticks"] and not self._is_terminated()

    def _info(self, obs: dict, action: NDArray[np.floating] | None = None) -> dict[str, Any]:
        """The decision's reward terms, mean speed (m/s) and ticks, the episode's metres and how it ended."""
        return {
            "reward_terms": dict(self._terms),
            "speed": self._metres / (self._ticks * self.vehicle.tick) if self._ticks else 0.0,
            "distance": self.distance,
            "collision": bool(self.vehicle.crashed),
            "off_lane": has_left_lane(self.route.lateral),
            "ticks": self._ticks,
        }

    def scene(self) -> Scene:
        """The present moment, for a live view or a recording."""
        ego, others = self.vehicle, self.road.background
        columns = (others.x, others.y, others.heading, others.speed, others.length, others.width)
        return Scene(
            step=self.decisions,
            time=float(self.time),
            ego=VehiclePose(
                float(ego.position[0]), float(ego.position[1]), ego.heading, ego.speed, ego.LENGTH, ego.WIDTH
            ),
            vehicles=tuple(VehiclePose(*row) for row in np.stack(columns, axis=1).tolist()),
            route=self.route.waypoints()[:, :2],
            waypoint=np.array(ego.waypoint),
            target_speed=ego.target_speed,
            steering=float(ego.action["steering"]),
            acceleration=float(ego.action["acceleration"]),
            reward=sum(self._terms.values()),
            reward_terms=dict(self._terms),
        )
