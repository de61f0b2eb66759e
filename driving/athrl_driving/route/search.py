"""The shortest way through a town: Dijkstra's search over the lanes and the changes between them."""

from __future__ import annotations

import heapq
import math
from itertools import pairwise

import numpy as np

from athrl_driving.compilation import compiled, inlined
from athrl_driving.errors import DrivingError
from athrl_driving.maps.lane_graph import Integers, LaneGraph

CHANGE_COST = 30.0
"""Metres of detour that are worth one lane change less."""

_ROOM_WANTED = 60.0
_COST_OF_MISSING_ROOM = 10.0


@inlined
def change_cost(graph: LaneGraph, row: int) -> float:
    """Return the metres that a lane change from `row` counts: short rows are avoided."""
    return CHANGE_COST + _COST_OF_MISSING_ROOM * max(_ROOM_WANTED - graph.length[row], 0.0)


def shortest_route(graph: LaneGraph, origin: int, destination: int, *, around: bool = False) -> Integers:
    """Return the rows, int64 [n], of the shortest way from one row to another, both included.

    Each row is a successor or a neighbour of the one before. With `around` a way from a row to itself leaves
    it and comes back. Raises ValueError in one line for a row that does not exist or cannot be reached.
    """
    rows = graph.length.size
    for name, row in (("origin", origin), ("destination", destination)):
        if not 0 <= row < rows:
            raise DrivingError(f"the {name} is lane {row}, it should be a lane from 0 to {rows - 1}")
    if origin == destination and not around:
        return np.array([origin], dtype=np.int64)
    before = search_back(graph, origin, destination)
    if before[destination] < 0:
        raise DrivingError(f"no way leads from lane {origin} to lane {destination} of the map")
    way = [destination, int(before[destination])]
    while way[-1] != origin:
        way.append(int(before[way[-1]]))
    return np.array(way[::-1], dtype=np.int64)


def plan_length(graph: LaneGraph, plan: Integers, start: float, destination: float) -> float:
    """Metres along a plan from `start` m along its first row to `destination` m along its last."""
    length = destination - start
    for row, following in pairwise(plan):
        # A row that is left for the one beside it goes on there at the same place.
        if following not in (graph.left[row], graph.right[row]):
            length += float(graph.length[row])
    return length


@compiled
def search_back(graph: LaneGraph, origin: int, destination: int) -> Integers:
    """Return int64 [L]: the row before each on the shortest way from `origin`, -1 where it was not needed.

    A row's cost is its length; ends when `destination` has been settled, which may be the origin again.
    """
    rows = graph.length.shape[0]
    distance = np.full(rows, math.inf)
    before = np.full(rows, -1)
    settled = np.zeros(rows, np.bool_)
    queue = [(0.0, origin)]
    leaving = True
    while len(queue) > 0:
        so_far, row = heapq.heappop(queue)
        if not leaving and row == destination:
            break
        if settled[row] and row != origin:
            continue
        if not leaving and row == origin:
            continue
        settled[row] = not leaving
        leaving = False
        for index in range(graph.successor_start[row], graph.successor_start[row + 1] + 2):
            step = index - graph.successor_start[row + 1]
            if step < 0:
                other, cost = graph.successor[index], graph.length[row]
            else:
                other = graph.left[row] if step == 0 else graph.right[row]
                cost = change_cost(graph, row)
            if other >= 0 and so_far + cost < distance[other]:
                distance[other] = so_far + cost
                before[other] = row
                heapq.heappush(queue, (distance[other], other))
    return before
