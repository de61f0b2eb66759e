"""How an episode begins, compiled: all but its traffic."""

import numpy as np

from ..compilation import compiled
from ..maps.geometry import lane_elevation, lane_pose
from ..maps.lane_graph import Integers, LaneGraph
from ..metrics import COMPLETION_SPEED, NO_COLLISION, MetricsState, environment_metrics, reset_metrics
from ..route import RouteState, environment_route, lanes_ahead, start_route
from .drive import clear_decision
from .ego import place_ego
from .state import DriveSettings, Progress


@compiled
def begin(
    settings: DriveSettings,
    graph: LaneGraph,
    routes: RouteState,
    metrics: MetricsState,
    progress: Progress,
    e: int,
    row: int,
    s: float,
    seed: np.uint64,
    plan: Integers,
    destination_s: float,
) -> None:
    """Begin an episode in environment `e`: the ego stands `s` metres along a row of the graph.

    The first arguments are fields of `EpisodeState`; `seed`, `plan` and `destination_s` are those of
    `start_route`.
    """
    route = environment_route(routes, e)
    start_route(graph, route, row, s, seed, plan, destination_s)
    x, y, heading = lane_pose(graph, row, s)
    place_ego(progress.ego[e], progress.control[e], x, y, heading, lane_elevation(graph, row, s))
    lanes_ahead(graph, route, progress.path[e])
    progress.obstacle_count[e] = 0
    progress.collision[e] = NO_COLLISION
    for flags in (progress.off_lane, progress.arrived, progress.terminated, progress.truncated):
        flags[e] = False
    for count in (progress.ticks, progress.decisions):
        count[e] = 0
    progress.distance[e] = 0.0
    clear_decision(progress, e)
    goal = COMPLETION_SPEED * settings.episode_ticks * settings.interval
    reset_metrics(environment_metrics(metrics, e), 0.0, heading, goal)
