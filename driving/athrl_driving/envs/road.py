"""The road of one episode, with its background traffic and its ego, as a road of highway-env."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from athrl_driving.envs.ego_vehicle import EgoVehicle
from athrl_driving.episode import Episodes
from athrl_driving.episode.state import OBSTACLES
from athrl_driving.traffic import BackgroundVehicle, TrafficRoad


class EpisodeRoad(TrafficRoad):
    """Shows environment `env_index` of `episodes`: `vehicles[0]` is the ego, the others are the background.

    `objects` on the road end the episode of an ego that touches them, as vehicles do.
    """

    def __init__(self, episodes: Episodes, env_index: int, record_history: bool = False) -> None:
        self._episodes = episodes
        super().__init__(episodes.town, episodes.state.traffic, env_index, record_history=record_history)
        state, settings, e = episodes.state.progress, episodes.state.settings, env_index
        ego = EgoVehicle.of_episode(
            self,
            state.ego[e],
            state.control[e],
            state.collision[e : e + 1],
            tick=settings.interval,
            speed_gain=settings.speed_gain,
        )
        background = [BackgroundVehicle(self, vehicle) for vehicle in range(self.background.x.size)]
        self.vehicles = [ego, *background]

    def __getstate__(self) -> dict[str, Any]:
        """Return the episodes and the objects; vehicles are views of the episodes' arrays."""
        return {
            "episodes": self._episodes,
            "env_index": self.environment,
            "record_history": self.record_history,
            "objects": self.objects,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Show the copied episodes, with the copied objects."""
        EpisodeRoad.__init__(self, state["episodes"], state["env_index"], state["record_history"])
        self.objects = state["objects"]

    @property
    def ego_path(self) -> NDArray[np.int64]:
        """int64 [n] lanes that the ego will drive, its present one first, then -1."""
        return self._episodes.state.progress.path[self.environment]

    @ego_path.setter
    def ego_path(self, value: NDArray[np.int64]) -> None:
        """Ignored: the episode's route determines the path."""

    def leader_of_ego(self) -> tuple[float, float]:
        """Return (gap m, speed m/s) of the next vehicle on the route, or (inf, 0).

        The gap is from bumper to bumper along the route.
        """
        self._episodes.find_leader(self.environment)
        scratch = self.traffic.scratch
        gap = float(scratch.gap[-1])
        return gap, float(scratch.leader_speed[-1]) if math.isfinite(gap) else 0.0

    def hand_over_objects(self) -> None:
        """Copy the objects on the road to the kernel's arrays; raises ValueError where there are too many.

        Their elevation is the ego's: highway-env's objects have none.
        """
        state, e = self._episodes.state.progress, self.environment
        if len(self.objects) > OBSTACLES:
            raise ValueError(f"{len(self.objects)} objects stand on the road, there may be {OBSTACLES}")
        state.obstacle_count[e] = len(self.objects)
        for index, thing in enumerate(self.objects):
            state.obstacles[e, index] = (*thing.position, thing.heading, thing.LENGTH, thing.WIDTH)
