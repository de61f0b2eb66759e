"""Starts a route, locates the ego on it, and returns poses along it."""

from __future__ import annotations

import math

import numpy as np
from numba import uint64
from numpy.typing import NDArray

from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import compiled, entry, inlined, inner
from athrl_driving.maps.arcs import pose_on_arc
from athrl_driving.maps.geometry import lane_pose, lane_project
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph
from athrl_driving.route.builder import append_segment, extend, laid_position, note_arrival
from athrl_driving.route.state import (
    CURVATURE,
    LENGTH,
    START_HEADING,
    START_POSITION,
    START_X,
    START_Y,
    RouteState,
    environment_route,
)

WAYPOINT_SPACING = 5.0
"""Distance between waypoints along the route, m."""

WAYPOINTS_KNOWN = 12
"""Waypoints ahead that the ego knows."""

KEPT_BEHIND = 30.0
"""Metres of route behind the ego that are always known: what the default window can show of it on a bend."""

LANES_AHEAD = 24
"""Lanes ahead that the traffic gets to know."""

KNOWN_AT_LEAST = 80.0
"""Metres of route ahead of the ego that are always known: with less it is extended."""

_BEFORE_FIRST_CHANGE = 5.0


@entry
def start_routes(
    graph: LaneGraph,
    routes: RouteState,
    environment: int,
    lane: int,
    s: float,
    seed: np.uint64,
    plan: Integers,
    destination_s: float,
) -> None:
    """Start the route of one environment; see `start_route`."""
    route = by_reference(environment_route(by_reference(routes), environment))
    start_route(by_reference(graph), route, lane, s, seed, plan, destination_s)


@inner
def start_route(
    graph: LaneGraph,
    route: RouteState,
    lane: int,
    s: float,
    seed: np.uint64,
    plan: Integers,
    destination_s: float,
) -> None:
    """Start a route `s` metres along a lane of the graph, where its position is 0.

    `plan` is int64 [n]: lanes to drive, the first of them `lane`, each a successor or a neighbour of the one
    before; empty for random turns, which also follow after a plan. `destination_s` is where on the plan's
    last lane the destination is, m. `seed` (uint64) starts the environment's random numbers.
    """
    route.random_state[0] = uint64(seed)
    route.segment_count[0] = route.ego_segment[0] = 0
    route.position[0] = -s
    route.lateral[0] = 0.0
    route.plan_count[0], route.plan_next[0] = plan.shape[0], 0
    for place in range(plan.shape[0]):
        route.plan[place] = plan[place]
    route.destination_s[0], route.arrival[0], route.end[0] = destination_s, math.inf, math.inf
    route.laid_lane[0], route.laid_s[0] = lane, s
    x, y, heading = lane_pose(graph, lane, 0.0)
    # The start of the lane lies behind the ego: the route is known there too.
    known_until = min(s + _BEFORE_FIRST_CHANGE, graph.length[lane])
    append_segment(route, x, y, heading, graph.curvature[lane], known_until, lane, 0.0)
    route.segments[0, START_POSITION] = -s
    route.laid_s[0] = known_until
    route.position[0] = 0.0
    note_arrival(route)
    extend(graph, route)


@inner
def follow(graph: LaneGraph, route: RouteState, x: float, y: float) -> None:
    """Update `position` and `lateral` for the ego's new place (m); drop segments behind, append ahead."""
    along, lateral = _project(route, route.ego_segment[0], x, y)
    while (
        route.ego_segment[0] + 1 < route.segment_count[0]
        and along > route.segments[route.ego_segment[0], LENGTH]
    ):
        route.ego_segment[0] += 1
        along, lateral = _project(route, route.ego_segment[0], x, y)
    route.position[0] = route.segments[route.ego_segment[0], START_POSITION] + along
    route.lateral[0] = lateral
    if laid_position(route) < route.position[0] + KNOWN_AT_LEAST:
        _drop_passed(route)
        extend(graph, route)


@inlined
def _drop_passed(route: RouteState) -> None:
    """Drop the segments that are far behind the ego."""
    behind = 0
    while (
        behind < route.ego_segment[0]
        and route.segments[behind, START_POSITION] + route.segments[behind, LENGTH]
        < route.position[0] - KEPT_BEHIND
    ):
        behind += 1
    if behind == 0:
        return
    for segment in range(behind, route.segment_count[0]):
        for column in range(6):
            route.segments[segment - behind, column] = route.segments[segment, column]
        route.lane[segment - behind] = route.lane[segment]
        route.lane_start[segment - behind] = route.lane_start[segment]
    route.segment_count[0] -= behind
    route.ego_segment[0] -= behind


@inlined
def _project(route: RouteState, index: int, x: float, y: float) -> tuple[float, float]:
    """Return (m along a segment, m to its right) of a point; on an arc only within half a circle."""
    segment = route.segments[index]
    cosine, sine = math.cos(segment[START_HEADING]), math.sin(segment[START_HEADING])
    dx, dy = x - segment[START_X], y - segment[START_Y]
    if segment[CURVATURE] == 0.0:
        return dx * cosine + dy * sine, dy * cosine - dx * sine
    radius = 1.0 / segment[CURVATURE]
    dx += radius * sine
    dy -= radius * cosine
    travelled = math.atan2((dx * cosine + dy * sine) * radius, (dx * sine - dy * cosine) * radius)
    distance = math.hypot(dx, dy)
    return travelled * radius, radius - distance if radius > 0.0 else radius + distance


@inlined
def segment_pose(segments: Floats, index: int, position: float) -> tuple[float, float, float]:
    """Return (x, y, heading) on a segment at a position along the route, m."""
    segment = segments[index]
    along = position - segment[START_POSITION]
    return pose_on_arc(segment[START_X], segment[START_Y], segment[START_HEADING], segment[CURVATURE], along)


@inlined
def segment_at(route: RouteState, position: float) -> int:
    """Return the segment on which a position along the route lies; the first or last beyond the ends."""
    index = route.ego_segment[0]
    while index > 0 and position < route.segments[index, START_POSITION]:
        index -= 1
    while index + 1 < route.segment_count[0] and position >= route.segments[index + 1, START_POSITION]:
        index += 1
    return index


@inlined
def route_pose(route: RouteState, position: float) -> tuple[float, float, float]:
    """Return (x, y, heading) at a position along the route, m."""
    return segment_pose(route.segments, segment_at(route, position), position)


@inlined
def heading_of_nearest_waypoint(route: RouteState) -> float:
    """Return the heading (rad) of the waypoint nearest to the ego along the route."""
    nearest = WAYPOINT_SPACING * round(route.position[0] / WAYPOINT_SPACING)
    return route_pose(route, max(nearest, route.segments[0, START_POSITION]))[2]


@inlined
def has_arrived(route: RouteState) -> bool:
    """Tell whether the ego has reached its destination; never without one."""
    return route.position[0] >= route.arrival[0]


@inlined
def has_ended(route: RouteState) -> bool:
    """Tell whether the ego has reached the end of its route, where no lane follows, as at the map's edge."""
    return route.position[0] >= route.end[0]


@inlined
def waypoints(route: RouteState) -> Floats:
    """Return float64 [12, 3]: x, y (m) and heading (rad) of the next waypoints."""
    poses = np.empty((WAYPOINTS_KNOWN, 3))
    first = math.floor(route.position[0] / WAYPOINT_SPACING) + 1
    index = route.ego_segment[0]
    for number in range(WAYPOINTS_KNOWN):
        position = (first + number) * WAYPOINT_SPACING
        while index + 1 < route.segment_count[0] and position >= route.segments[index + 1, START_POSITION]:
            index += 1
        poses[number, 0], poses[number, 1], poses[number, 2] = segment_pose(route.segments, index, position)
    return poses


@inlined
def lanes_ahead(graph: LaneGraph, route: RouteState, lanes: Integers) -> None:
    """Fill `lanes` int64 [n] with the lanes that the ego will drive, the present one first, then -1.

    Where the route changes lanes, a lane is followed by its neighbour; the ego is on the lane that it leaves
    until its centre has crossed the line between them.
    """
    lanes[:] = -1
    count, last = 0, -1
    present = route.lane[route.ego_segment[0]]
    x, y, _ = route_pose(route, route.position[0])
    across = lane_project(graph, present, x, y)[1]
    old_lane = -1
    if abs(across) > 0.5 * graph.width[present]:
        old_lane = graph.right[present] if across > 0.0 else graph.left[present]
    if old_lane >= 0:
        lanes[0] = old_lane
        count = 1
    for index in range(route.ego_segment[0], route.segment_count[0]):
        if route.lane[index] != last:
            if count == lanes.shape[0]:
                return
            last = route.lane[index]
            lanes[count] = last
            count += 1


@compiled
def poses_on_route(segments: Floats, count: int, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [n, 3]: x, y, heading at ascending positions (m) on a route of `count` segments."""
    poses = np.empty((positions.shape[0], 3))
    index = 0
    for place in range(positions.shape[0]):
        while index + 1 < count and positions[place] >= segments[index + 1, START_POSITION]:
            index += 1
        poses[place, 0], poses[place, 1], poses[place, 2] = segment_pose(segments, index, positions[place])
    return poses
