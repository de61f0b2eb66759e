"""Starting a route, finding the ego on it, and poses along it."""

from __future__ import annotations

import math

import numpy as np
from numba import uint64
from numpy.typing import NDArray

from athrl_driving.compilation import compiled, inlined, inner
from athrl_driving.maps.geometry import lane_pose, lane_project
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph
from athrl_driving.route.laying import append_piece, extend, laid_position, note_arrival
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

KEPT_BEHIND = 20.0
"""Metres of route behind the ego that are kept, enough for the window of the observation."""

LANES_AHEAD = 24
"""Rows ahead that the traffic is told of."""

KNOWN_AT_LEAST = 80.0
"""Metres ahead below which the route is extended."""

_BEFORE_FIRST_CHANGE = 5.0


@compiled
def start_routes(
    graph: LaneGraph,
    routes: RouteState,
    environment: int,
    row: int,
    s: float,
    seed: np.uint64,
    plan: Integers,
    destination_s: float,
) -> None:
    """Start the route of one environment; see `start_route`."""
    start_route(graph, environment_route(routes, environment), row, s, seed, plan, destination_s)


@inner
def start_route(
    graph: LaneGraph,
    route: RouteState,
    row: int,
    s: float,
    seed: np.uint64,
    plan: Integers,
    destination_s: float,
) -> None:
    """Begin a route `s` metres along a row of the graph; its own position there is 0.

    `plan` is int64 [n]: rows to drive, the first of them `row`, each a successor or a neighbour of the one
    before; empty for random turns, which also follow a plan. `destination_s` is where on the plan's last row
    the destination is, m. `seed` (uint64) begins the environment's random numbers.
    """
    route.random_state[0] = uint64(seed)
    route.piece_count[0] = route.ego_piece[0] = 0
    route.position[0] = -s
    route.lateral[0] = 0.0
    route.plan_count[0], route.plan_next[0] = plan.shape[0], 0
    for place in range(plan.shape[0]):
        route.plan[place] = plan[place]
    route.destination_s[0], route.arrival[0] = destination_s, math.inf
    route.laid_row[0], route.laid_s[0] = row, s
    x, y, heading = lane_pose(graph, row, 0.0)
    # The row's beginning lies behind the ego: the route is known there too.
    laid = min(s + _BEFORE_FIRST_CHANGE, graph.length[row])
    append_piece(route, x, y, heading, graph.curvature[row], laid, row, 0.0)
    route.pieces[0, START_POSITION] = -s
    route.laid_s[0] = laid
    route.position[0] = 0.0
    note_arrival(route)
    extend(graph, route)


@inner
def follow(graph: LaneGraph, route: RouteState, x: float, y: float) -> None:
    """Take the ego's new place (m): set `position` and `lateral`, forget what is behind, lay what comes."""
    along, lateral = _project(route, route.ego_piece[0], x, y)
    while route.ego_piece[0] + 1 < route.piece_count[0] and along > route.pieces[route.ego_piece[0], LENGTH]:
        route.ego_piece[0] += 1
        along, lateral = _project(route, route.ego_piece[0], x, y)
    route.position[0] = route.pieces[route.ego_piece[0], START_POSITION] + along
    route.lateral[0] = lateral
    if laid_position(route) < route.position[0] + KNOWN_AT_LEAST:
        _forget(route)
        extend(graph, route)


@inlined
def _forget(route: RouteState) -> None:
    """Drop the pieces that lie far behind."""
    behind = 0
    while (
        behind < route.ego_piece[0]
        and route.pieces[behind, START_POSITION] + route.pieces[behind, LENGTH]
        < route.position[0] - KEPT_BEHIND
    ):
        behind += 1
    if behind == 0:
        return
    for piece in range(behind, route.piece_count[0]):
        for column in range(6):
            route.pieces[piece - behind, column] = route.pieces[piece, column]
        route.row[piece - behind] = route.row[piece]
        route.row_start[piece - behind] = route.row_start[piece]
    route.piece_count[0] -= behind
    route.ego_piece[0] -= behind


@inlined
def _project(route: RouteState, index: int, x: float, y: float) -> tuple[float, float]:
    """Return (m along a piece, m to its right) of a point; on an arc within half a circle."""
    piece = route.pieces[index]
    cosine, sine = math.cos(piece[START_HEADING]), math.sin(piece[START_HEADING])
    dx, dy = x - piece[START_X], y - piece[START_Y]
    if piece[CURVATURE] == 0.0:
        return dx * cosine + dy * sine, dy * cosine - dx * sine
    radius = 1.0 / piece[CURVATURE]
    dx += radius * sine
    dy -= radius * cosine
    travelled = math.atan2((dx * cosine + dy * sine) * radius, (dx * sine - dy * cosine) * radius)
    distance = math.hypot(dx, dy)
    return travelled * radius, radius - distance if radius > 0.0 else radius + distance


@inlined
def piece_pose(pieces: Floats, index: int, position: float) -> tuple[float, float, float]:
    """Return (x, y, heading) on a piece at a position along the route, m."""
    along = position - pieces[index, START_POSITION]
    # The chord of an arc lies along the mean of its two headings.
    half = 0.5 * pieces[index, CURVATURE] * along
    chord = along if abs(half) < 1e-12 else along * math.sin(half) / half
    middle = pieces[index, START_HEADING] + half
    return (
        pieces[index, START_X] + chord * math.cos(middle),
        pieces[index, START_Y] + chord * math.sin(middle),
        middle + half,
    )


@inlined
def piece_at(route: RouteState, position: float) -> int:
    """Return the piece on which a position along the route lies; the first or last beyond the ends."""
    index = route.ego_piece[0]
    while index > 0 and position < route.pieces[index, START_POSITION]:
        index -= 1
    while index + 1 < route.piece_count[0] and position >= route.pieces[index + 1, START_POSITION]:
        index += 1
    return index


@inlined
def route_pose(route: RouteState, position: float) -> tuple[float, float, float]:
    """Return (x, y, heading) at a position along the route, m."""
    return piece_pose(route.pieces, piece_at(route, position), position)


@inlined
def heading_of_nearest_waypoint(route: RouteState) -> float:
    """Return the heading (rad) of the waypoint nearest to the ego along the route."""
    nearest = WAYPOINT_SPACING * round(route.position[0] / WAYPOINT_SPACING)
    return route_pose(route, max(nearest, route.pieces[0, START_POSITION]))[2]


@inlined
def has_arrived(route: RouteState) -> bool:
    """Tell whether the ego has reached its destination; never without one."""
    return route.position[0] >= route.arrival[0]


@inlined
def waypoints(route: RouteState) -> Floats:
    """Return float64 [12, 3]: x, y (m) and heading (rad) of the next waypoints."""
    poses = np.empty((WAYPOINTS_KNOWN, 3))
    first = math.floor(route.position[0] / WAYPOINT_SPACING) + 1
    index = route.ego_piece[0]
    for number in range(WAYPOINTS_KNOWN):
        position = (first + number) * WAYPOINT_SPACING
        while index + 1 < route.piece_count[0] and position >= route.pieces[index + 1, START_POSITION]:
            index += 1
        poses[number, 0], poses[number, 1], poses[number, 2] = piece_pose(route.pieces, index, position)
    return poses


@inlined
def lanes_ahead(graph: LaneGraph, route: RouteState, rows: Integers) -> None:
    """Fill `rows` int64 [n] with the rows that the ego will drive, its present one first; -1 after the last.

    Where the route changes lanes, a row is followed by its neighbour; the ego is on the row that it leaves
    until its centre has crossed the line between them.
    """
    rows[:] = -1
    count, last = 0, -1
    present = route.row[route.ego_piece[0]]
    x, y, _ = route_pose(route, route.position[0])
    across = lane_project(graph, present, x, y)[1]
    left_behind = -1
    if abs(across) > 0.5 * graph.width[present]:
        left_behind = graph.right[present] if across > 0.0 else graph.left[present]
    if left_behind >= 0:
        rows[0] = left_behind
        count = 1
    for index in range(route.ego_piece[0], route.piece_count[0]):
        if route.row[index] != last:
            if count == rows.shape[0]:
                return
            last = route.row[index]
            rows[count] = last
            count += 1


@compiled
def poses_on_route(pieces: Floats, count: int, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [n, 3]: x, y, heading at ascending positions (m) on a route of `count` pieces."""
    poses = np.empty((positions.shape[0], 3))
    index = 0
    for place in range(positions.shape[0]):
        while index + 1 < count and positions[place] >= pieces[index + 1, START_POSITION]:
            index += 1
        poses[place, 0], poses[place, 1], poses[place, 2] = piece_pose(pieces, index, positions[place])
    return poses
