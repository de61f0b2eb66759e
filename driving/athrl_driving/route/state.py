"""The routes of a batch of environments as arrays, which the route's kernels read and write."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.kernels.environment_views import view_maker
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph

SEGMENTS = 128
"""Room for the segments of a route that are known at once, behind and ahead of the ego."""

PLAN_LANES = 2048
"""Greatest number of lanes of a planned route."""

START_X, START_Y, START_HEADING, CURVATURE, LENGTH, START_POSITION = range(6)
"""Columns of `segments`."""

TO_THE_EDGE, TO_A_CHANGE = 1e9, 2e9
"""More metres than any path has: values of `lanes_reach`, greater where a route rather leads."""


class RouteState(NamedTuple):
    """The routes of E environments, or without that axis the route of one (see `environment_route`).

    A route is a chain of segments, each exactly a straight line or an arc. Along a lane a segment is the
    lane's centre line; a change to the lane beside it is an S of two arcs, cut where lanes end.
    """

    segments: Floats
    """[E, SEGMENTS, 6]: x, y (m), heading (rad), curvature (1/m), length (m), metres along the route."""
    lane: Integers
    """[E, SEGMENTS] lane of the lane graph; during a lane change the new lane."""
    lane_start: Floats
    """[E, SEGMENTS] m along that lane where the segment starts."""
    segment_count: Integers
    """[E] how many segments are known."""
    ego_segment: Integers
    """[E] the segment that the ego is on."""
    position: Floats
    """[E] m along the route, 0 where the episode began."""
    lateral: Floats
    """[E] m that the ego is beside the route, positive to the right."""
    laid_lane: Integers
    """[E] lane on which the last segment ends."""
    laid_s: Floats
    """[E] m along that lane."""
    random_state: NDArray[np.uint64]
    """[E] each environment's own random numbers."""
    plan: Integers
    """[E, PLAN_LANES] lanes to drive; random turns follow after them."""
    plan_count: Integers
    """[E] how many lanes the plan has, 0 without one."""
    plan_next: Integers
    """[E] place in the plan of the lane on which the last segment ends."""
    destination_s: Floats
    """[E] m along the plan's last lane."""
    arrival: Floats
    """[E] the destination's place along the route, m; infinite without one or before the route reaches it."""
    end: Floats
    """[E] the route's end, m along it: no lane follows; infinite while the route goes on."""
    lanes_reach: Floats
    """[L] (all environments share it) see `lanes_reach`."""


def new_routes(graph: LaneGraph, environments: int) -> RouteState:
    """Allocate the routes of `environments` environments in the graph's town."""
    count = environments
    return RouteState(
        segments=np.zeros((count, SEGMENTS, 6)),
        lane=np.zeros((count, SEGMENTS), np.int64),
        lane_start=np.zeros((count, SEGMENTS)),
        segment_count=np.zeros(count, np.int64),
        ego_segment=np.zeros(count, np.int64),
        position=np.zeros(count),
        lateral=np.zeros(count),
        laid_lane=np.zeros(count, np.int64),
        laid_s=np.zeros(count),
        random_state=np.zeros(count, np.uint64),
        plan=np.zeros((count, PLAN_LANES), np.int64),
        plan_count=np.zeros(count, np.int64),
        plan_next=np.zeros(count, np.int64),
        destination_s=np.zeros(count),
        arrival=np.full(count, np.inf),
        end=np.full(count, np.inf),
        lanes_reach=lanes_reach(graph),
    )


def dead_end_distance(graph: LaneGraph) -> Floats:
    """Return [L]: m from a lane's start to the end of its longest path without lane change, often inf.

    A path ends at a dead end or at the map's edge.
    """
    lane_count = graph.length.size
    distance = np.full(lane_count, np.inf)
    waiting = np.diff(graph.successor_start).astype(np.int64)
    predecessors = _predecessors(graph)
    longest = np.zeros(lane_count)
    ended = [int(lane) for lane in np.flatnonzero(waiting == 0)]
    while ended:
        lane = ended.pop()
        distance[lane] = graph.length[lane] + longest[lane]
        for before in predecessors[lane]:
            longest[before] = max(longest[before], distance[lane])
            waiting[before] -= 1
            if waiting[before] == 0:
                ended.append(before)
    return distance


def lanes_reach(graph: LaneGraph) -> Floats:
    """Return [L]: how far a route leads on from a lane without lane change, so that the farthest is best.

    It is the distance (m) to a dead end; `TO_THE_EDGE` where paths lead off the map, `TO_A_CHANGE` where they
    do unless the lane is changed on the way, and infinite where they never end.
    """
    reach = dead_end_distance(graph)
    predecessors = _predecessors(graph)
    leads_off = np.zeros(reach.size, np.bool_)
    _spread(leads_off, np.flatnonzero(graph.leaves[: reach.size]).tolist(), predecessors)
    leads_off &= np.isfinite(reach)
    reach[leads_off] = TO_THE_EDGE
    if leads_off.any():
        for beside in (graph.left, graph.right):
            for lane in np.flatnonzero(beside >= 0).tolist():
                predecessors[beside[lane]].append(lane)
        goes_on = np.zeros(reach.size, np.bool_)
        _spread(goes_on, np.flatnonzero(np.isinf(reach)).tolist(), predecessors)
        reach[leads_off & goes_on] = TO_A_CHANGE
    return reach


def _predecessors(graph: LaneGraph) -> list[list[int]]:
    """Return the lanes that lead to each lane."""
    predecessors: list[list[int]] = [[] for _ in range(graph.length.size)]
    for lane in range(graph.length.size):
        for following in graph.successor[graph.successor_start[lane] : graph.successor_start[lane + 1]]:
            predecessors[following].append(lane)
    return predecessors


def _spread(flags: NDArray[np.bool_], waiting: list[int], predecessors: list[list[int]]) -> None:
    """Set the flags [L] of the lanes in `waiting`, and of all from which one of them can be reached."""
    flags[waiting] = True
    while waiting:
        for before in predecessors[waiting.pop()]:
            if not flags[before]:
                flags[before] = True
                waiting.append(before)


environment_route = view_maker(
    RouteState,
    numbers=[
        *("segment_count", "ego_segment", "position", "lateral", "laid_lane", "laid_s", "random_state"),
        *("plan_count", "plan_next", "destination_s", "arrival", "end"),
    ],
    shared=["lanes_reach"],
)
"""(routes, environment) -> the route of one environment: the same memory without the first axis."""
