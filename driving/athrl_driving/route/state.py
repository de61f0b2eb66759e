"""The routes of a batch of environments as arrays; what the route's kernels read and write."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.compilation import inlined
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph

PIECES = 128
"""Pieces of a route that are known at once, behind and ahead of the ego."""

PLAN_ROWS = 2048
"""Rows of the lane graph that a planned route may have."""

START_X, START_Y, START_HEADING, CURVATURE, LENGTH, START_POSITION = range(6)
"""Columns of `pieces`."""


class RouteState(NamedTuple):
    """The routes of E environments, or without that axis the route of one (see `environment_route`).

    A route is a chain of pieces, each exactly a straight line or an arc. On a lane a piece is the lane's own
    line; a change to the lane beside it is an S of two arcs, cut where the lane's rows end.
    """

    pieces: Floats
    """[E, PIECES, 6]: x, y (m), heading (rad), curvature (1/m), length (m), metres along the route."""
    row: Integers
    """[E, PIECES] row of the lane graph; while changing lanes the one that is changed to."""
    row_start: Floats
    """[E, PIECES] m along that row where the piece starts."""
    piece_count: Integers
    """[E] pieces that are known."""
    ego_piece: Integers
    """[E] the piece that the ego is on."""
    position: Floats
    """[E] m along the route, 0 where the episode began."""
    lateral: Floats
    """[E] m that the ego is beside the route, positive to the right."""
    laid_row: Integers
    """[E] row on which the last piece ends."""
    laid_s: Floats
    """[E] m along that row."""
    random_state: NDArray[np.uint64]
    """[E] each environment's own random numbers."""
    plan: Integers
    """[E, PLAN_ROWS] rows to be driven; followed by random turns."""
    plan_count: Integers
    """[E] rows of the plan, 0 without one."""
    plan_next: Integers
    """[E] place in the plan of the row on which the last piece ends."""
    destination_s: Floats
    """[E] m along the plan's last row."""
    arrival: Floats
    """[E] the destination's place along the route, m; infinite without one or while it is not yet laid."""
    dead_end_distance: Floats
    """[L] (all environments share it) m from a row's start to where every way on ends; see that function."""


def new_routes(graph: LaneGraph, environments: int) -> RouteState:
    """Make room for the routes of `environments` environments in the graph's town."""
    count = environments
    return RouteState(
        pieces=np.zeros((count, PIECES, 6)),
        row=np.zeros((count, PIECES), np.int64),
        row_start=np.zeros((count, PIECES)),
        piece_count=np.zeros(count, np.int64),
        ego_piece=np.zeros(count, np.int64),
        position=np.zeros(count),
        lateral=np.zeros(count),
        laid_row=np.zeros(count, np.int64),
        laid_s=np.zeros(count),
        random_state=np.zeros(count, np.uint64),
        plan=np.zeros((count, PLAN_ROWS), np.int64),
        plan_count=np.zeros(count, np.int64),
        plan_next=np.zeros(count, np.int64),
        destination_s=np.zeros(count),
        arrival=np.full(count, np.inf),
        dead_end_distance=dead_end_distance(graph),
    )


@inlined
def environment_route(routes: RouteState, environment: int) -> RouteState:
    """Return the route of one environment: the same fields without their first axis, no copies.

    Its single numbers are arrays [1].
    """
    e = environment
    return RouteState(
        routes.pieces[e],
        routes.row[e],
        routes.row_start[e],
        routes.piece_count[e : e + 1],
        routes.ego_piece[e : e + 1],
        routes.position[e : e + 1],
        routes.lateral[e : e + 1],
        routes.laid_row[e : e + 1],
        routes.laid_s[e : e + 1],
        routes.random_state[e : e + 1],
        routes.plan[e],
        routes.plan_count[e : e + 1],
        routes.plan_next[e : e + 1],
        routes.destination_s[e : e + 1],
        routes.arrival[e : e + 1],
        routes.dead_end_distance,
    )


def dead_end_distance(graph: LaneGraph) -> Floats:
    """[L] m from a row's start to where its longest way without a lane change ends; mostly infinite."""
    rows = graph.length.size
    distance = np.full(rows, np.inf)
    waiting = np.diff(graph.successor_start).astype(np.int64)
    predecessors: list[list[int]] = [[] for _ in range(rows)]
    for row in range(rows):
        for following in graph.successor[graph.successor_start[row] : graph.successor_start[row + 1]]:
            predecessors[following].append(row)
    longest = np.zeros(rows)
    ended = [int(row) for row in np.flatnonzero(waiting == 0)]
    while ended:
        row = ended.pop()
        distance[row] = graph.length[row] + longest[row]
        for before in predecessors[row]:
            longest[before] = max(longest[before], distance[row])
            waiting[before] -= 1
            if waiting[before] == 0:
                ended.append(before)
    return distance
