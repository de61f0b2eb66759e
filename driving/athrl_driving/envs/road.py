"""The road of one episode: its background traffic and its ego, as highway-env knows them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from athrl_driving.envs.ego_vehicle import EgoVehicle
from athrl_driving.episode import Episodes
from athrl_driving.episode.state import OBSTACLES
from athrl_driving.traffic import BackgroundVehicle, TrafficRoad


class EpisodeRoad(TrafficRoad):
    """Shows environment `e` of `episodes`: `vehicles[0]` is the ego, the others are the background.

    `objects` that stand on the road end the episode of an ego that touches them, as vehicles do.
    """

    def __init__(self, episodes: Episodes, e: int, record_history: bool = False) -> None:
        self._episodes = episodes
        super().__init__(episodes.town, episodes.state.traffic, e, record_history=record_history)
        state, interval = episodes.state.progress, episodes.state.settings.interval
        ego = EgoVehicle.of_episode(
            self, state.ego[e], state.control[e], state.collision[e : e + 1], interval
        )
        background = [BackgroundVehicle(self, row) for row in range(self.background.x.size)]
        self.vehicles = [ego, *background]

    @property
    def ego_path(self) -> NDArray[np.int64]:
        """int64 [n] rows of the lane graph that the ego will drive, its present one first, then -1."""
        return self._episodes.state.progress.path[self.environment]

    @ego_path.setter
    def ego_path(self, value: NDArray[np.int64]) -> None:
        """The episode's route says where the ego goes."""

    def leader_of_ego(self) -> tuple[float, float]:
        """Return (gap m, speed m/s) of the next vehicle on the route, or (inf, 0).

        The gap is from bumper to bumper along the route.
        """
        self._episodes.look(self.environment)
        scratch = self.traffic.scratch
        gap = float(scratch.gap[-1])
        return gap, float(scratch.leader_speed[-1]) if math.isfinite(gap) else 0.0

    def hand_over_objects(self) -> None:
        """Tell the kernel what stands on the road; raises ValueError where that is more than it has room for.

        Their elevation is the ego's: highway-env's objects have none.
        """
        state, e = self._episodes.state.progress, self.environment
        if len(self.objects) > OBSTACLES:
            raise ValueError(f"{len(self.objects)} objects stand on the road, there may be {OBSTACLES}")
        state.obstacle_count[e] = len(self.objects)
        for row, thing in enumerate(self.objects):
            state.obstacles[e, row] = (*thing.position, thing.heading, thing.LENGTH, thing.WIDTH)
