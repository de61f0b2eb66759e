"""The shortest route through a town: Dijkstra's search over the lanes and the lane changes between them."""

from __future__ import annotations

import heapq
import math
from itertools import pairwise

import numpy as np

from athrl_driving.errors import DrivingError
from athrl_driving.kernels.compilation import compiled, inlined
from athrl_driving.maps.lane_graph import Integers, LaneGraph

CHANGE_COST = 30.0
"""Metres that a lane change costs: a detour of this length is as good as one lane change."""

_ROOM_WANTED = 60.0
_COST_OF_MISSING_ROOM = 10.0


LEAST_ROOM = 15.0
"""Metres of its first lane that a route needs for a lane change there: a few before it, and an S in 10 m."""


@inlined
def change_cost(graph: LaneGraph, lane: int, start: float) -> float:
    """Return the cost (m) of a change from `start` m along a lane: greater where little of it is left."""
    return CHANGE_COST + _COST_OF_MISSING_ROOM * max(_ROOM_WANTED - (graph.length[lane] - start), 0.0)


def shortest_route(
    graph: LaneGraph,
    origin: int,
    destination: int,
    *,
    start: float = 0.0,
    goal: float = math.inf,
    around: bool = False,
) -> Integers:
    """Return the lanes, int64 [n], of the shortest route from one lane to another, both included.

    Each lane is a successor or a neighbour of the one before. The route begins `start` m along its first
    lane, from which it changes lanes only where `LEAST_ROOM` is left. It does not change to its last lane
    beyond `goal` m. With `around` a route from a lane to itself leaves it and comes back. Raises ValueError
    in one line for a lane that does not exist or cannot be reached.
    """
    count = graph.length.size
    for name, lane in (("origin", origin), ("destination", destination)):
        if not 0 <= lane < count:
            raise DrivingError(f"the {name} is lane {lane}, it should be a lane from 0 to {count - 1}")
    if origin == destination and not around:
        return np.array([origin], dtype=np.int64)
    before = search_back(graph, origin, destination, start, goal)
    if before[destination] < 0:
        raise DrivingError(f"no way leads from lane {origin} to lane {destination} of the map")
    route = [destination, int(before[destination])]
    while route[-1] != origin:
        route.append(int(before[route[-1]]))
    return np.array(route[::-1], dtype=np.int64)


def plan_length(graph: LaneGraph, plan: Integers, start: float, destination: float) -> float:
    """Return the metres along a plan from `start` m on its first lane to `destination` m on its last."""
    length = destination - start
    for lane, following in pairwise(plan):
        # A lane change continues at the same place on the lane beside.
        if following not in (graph.left[lane], graph.right[lane]):
            length += float(graph.length[lane])
    return length


@compiled
def search_back(graph: LaneGraph, origin: int, destination: int, start: float, goal: float) -> Integers:
    """Return int64 [L]: the lane before each on the shortest route from `origin`, -1 where not reached.

    A lane's cost is its length; ends when `destination` has been settled, which may be the origin again.
    """
    count = graph.length.shape[0]
    distance = np.full(count, math.inf)
    before = np.full(count, -1)
    entered = np.zeros(count)  # m along each lane where the route comes onto it
    settled = np.zeros(count, np.bool_)
    queue = [(0.0, origin)]
    leaving = True
    while len(queue) > 0:
        so_far, lane = heapq.heappop(queue)
        if not leaving and lane == destination:
            break
        if settled[lane] and lane != origin:
            continue
        if not leaving and lane == origin:
            continue
        settled[lane] = not leaving
        along = start if leaving else entered[lane]
        has_room = not leaving or graph.length[lane] - start >= LEAST_ROOM
        for index in range(graph.successor_start[lane], graph.successor_start[lane + 1] + 2):
            step = index - graph.successor_start[lane + 1]
            if step < 0:
                other, cost, at = graph.successor[index], graph.length[lane], 0.0
            else:
                other = graph.left[lane] if step == 0 else graph.right[lane]
                if other < 0 or not has_room:
                    continue
                cost = change_cost(graph, lane, start if leaving else 0.0)
                at = along * graph.length[other] / graph.length[lane]
                if other == destination and at > goal:
                    continue
            if so_far + cost < distance[other]:
                distance[other] = so_far + cost
                before[other] = lane
                entered[other] = at
                heapq.heappush(queue, (distance[other], other))
        leaving = False
    return before
