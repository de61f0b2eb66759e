"""The state of E episodes that run side by side, as arrays with a leading environment axis.

Observations, rewards and the values of `info` are part of it: the kernel writes them where Python reads them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.episode.ego import CONTROL_SIZE
from athrl_driving.episode.observation_arrays import ObservationArrays
from athrl_driving.maps import Town
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.metrics import MetricsState, new_metrics
from athrl_driving.perception import Perception
from athrl_driving.reward import REWARD_TERMS
from athrl_driving.route import LANES_AHEAD, RouteState, new_routes
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.state import Traffic, new_traffic

OBSTACLES = 8
"""The most obstacles on the road of an episode."""


class DriveSettings(NamedTuple):
    """What a decision means and how long everything lasts."""

    interval: float
    """Length of a tick, s."""
    ticks_per_decision: int
    episode_ticks: int
    """Ticks after which an episode is truncated."""
    maximum_speed: float
    """Highest target speed, m/s."""
    waypoint_radius: float
    """Distance of the waypoint, m."""
    waypoint_half_angle: float
    """Angle of the outermost waypoints, rad."""
    speed_gain: float
    """Acceleration towards the target speed for each m/s that is missing, 1/s."""
    action_kind: int
    """Number of the kind of action, its place in `athrl_spaces.ACTION_KINDS`."""


class Progress(NamedTuple):
    """Position and progress of the ego of each episode, and the results of its last decision."""

    ego: Floats
    """[E, 8] columns as in `traffic.ego_columns`."""
    control: Floats
    """[E, 10] columns as in `episode.ego`."""
    path: Integers
    """[E, LANES_AHEAD] lanes that the ego will drive, its present one first, then -1."""
    obstacles: Floats
    """[E, OBSTACLES, 5] x, y (m), heading (rad), length, width (m) of standing obstacles."""
    obstacle_count: Integers
    """[E]"""
    collision: Integers
    """[E] kind of the collision that ended the episode, 0 none."""
    off_lane: NDArray[np.bool_]
    """[E] the lane has been left."""
    arrived: NDArray[np.bool_]
    """[E] the destination has been reached."""
    route_end: NDArray[np.bool_]
    """[E] the route's end has been reached: no lane follows, as at the map's edge."""
    terminated: NDArray[np.bool_]
    """[E]"""
    truncated: NDArray[np.bool_]
    """[E]"""
    ticks: Integers
    """[E] of the episode."""
    decisions: Integers
    """[E] of the episode."""
    decision_ticks: Integers
    """[E] of the last decision."""
    terms: Floats
    """[E, 7] reward terms of the last decision, in the order of `REWARD_TERMS`."""
    reward: Floats
    """[E] their sum."""
    speed: Floats
    """[E] mean speed of the last decision, m/s."""
    distance: Floats
    """[E] driven in the episode, m."""
    lidar: Floats
    """[E, rays] m to the first vehicle, clockwise from straight ahead; infinite where there is none."""


class EpisodeState(NamedTuple):
    """Everything that a decision reads and writes; kernels take its parts, as a wide tuple is costly."""

    settings: DriveSettings
    traffic: Traffic
    routes: RouteState
    metrics: MetricsState
    perception: Perception
    progress: Progress
    observations: ObservationArrays


class Views(NamedTuple):
    """One environment's own traffic, route and metrics: the same memory without the environment axis."""

    traffic: Traffic
    route: RouteState
    metrics: MetricsState


def new_state(
    town: Town,
    settings: DriveSettings,
    perception: Perception,
    observations: ObservationArrays,
    vehicles: int,
) -> EpisodeState:
    """Allocate an episode for each environment of `observations`, with so many vehicles; none has begun."""
    environments = observations.env_index.size
    return EpisodeState(
        settings=settings,
        traffic=new_traffic(town, environments, vehicles),
        routes=new_routes(town.graph, environments),
        metrics=new_metrics(environments),
        perception=perception,
        progress=_new_progress(environments, perception.ray_cosine.size),
        observations=observations,
    )


def _new_progress(count: int, rays: int) -> Progress:
    return Progress(
        ego=np.zeros((count, EGO_SIZE)),
        control=np.zeros((count, CONTROL_SIZE)),
        path=np.full((count, LANES_AHEAD), -1),
        obstacles=np.zeros((count, OBSTACLES, 5)),
        obstacle_count=np.zeros(count, np.int64),
        collision=np.zeros(count, np.int64),
        off_lane=np.zeros(count, np.bool_),
        arrived=np.zeros(count, np.bool_),
        route_end=np.zeros(count, np.bool_),
        terminated=np.zeros(count, np.bool_),
        truncated=np.zeros(count, np.bool_),
        ticks=np.zeros(count, np.int64),
        decisions=np.zeros(count, np.int64),
        decision_ticks=np.zeros(count, np.int64),
        terms=np.zeros((count, len(REWARD_TERMS))),
        reward=np.zeros(count),
        speed=np.zeros(count),
        distance=np.zeros(count),
        lidar=np.full((count, rays), np.inf),
    )
