"""The next lane change of the route, and the traffic on the lane that it leads to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.drivers.driver import DrivenTown
from athrl_driving.maps.lane_graph import LaneGraph

LOOK_AHEAD = 50.0
"""Distance before a lane change at which a driver considers it, m."""

_REACH = 60.0


class LaneChange(NamedTuple):
    """The next lane change on the route and the traffic on the lane that it leads to."""

    distance: float
    """m from the ego's centre to where the lane change begins; negative during the lane change."""
    gap_ahead: float
    """m from bumper to bumper to the next vehicle, with the ego projected onto that lane; inf without one."""
    speed_ahead: float
    """m/s"""
    gap_behind: float
    """m to the vehicle behind, negative if it is beside the ego; inf without one."""
    speed_behind: float
    """m/s"""


def next_lane_change(env: DrivenTown) -> LaneChange | None:
    """Return the next lane change on the route, or None where none is near.

    A lane change ends when the ego's centre has crossed the line between the lanes.
    """
    graph, route = env.town.graph, env.route
    lanes, starts, index = route.lanes, route.starts, route.index
    if route.lanes_ahead[0] != lanes[index]:
        # During a lane change the route is already on the new lane and the ego still on the old one.
        return _lane_change_to(env, int(lanes[index]), route.place_on_lane(route.position), -1.0)
    for place in range(index + 1, lanes.size):
        distance = float(starts[place]) - route.position
        if distance > LOOK_AHEAD:
            break
        if lanes[place] in (graph.left[lanes[place - 1]], graph.right[lanes[place - 1]]):
            station = route.place_on_lane(float(starts[place])) - distance
            return _lane_change_to(env, int(lanes[place]), station, distance)
    return None


def _lane_change_to(env: DrivenTown, lane: int, station: float, distance: float) -> LaneChange:
    """Find the vehicles around a place `station` m along a lane, which may be before or behind its ends."""
    ego, others = env.vehicle, env.road.background
    ahead, behind = (math.inf, 0.0), (math.inf, 0.0)
    for near, start in _lanes_around(env.town.graph, lane):
        for vehicle in np.flatnonzero(others.lane == near):
            along = start + float(others.s[vehicle]) - station
            gap = abs(along) - 0.5 * (ego.LENGTH + float(others.length[vehicle]))
            seen = (gap, float(others.speed[vehicle]))
            if along >= 0.0:
                ahead = min(ahead, seen)
            else:
                behind = min(behind, seen)
    return LaneChange(distance, *ahead, *behind)


def _lanes_around(graph: LaneGraph, lane: int) -> list[tuple[int, float]]:
    """The lanes within reach of a lane, each with the metres from the lane's start to its own start."""
    found = {lane: 0.0}
    waiting = [(lane, 0.0, 1), (lane, 0.0, -1)]
    while waiting:
        present, start, way = waiting.pop()
        if way > 0:
            end = start + float(graph.length[present])
            nearby = [(int(other), end) for other in _successors(graph, present)]
        else:
            predecessors = _predecessors(graph, present)
            nearby = [(int(other), start - float(graph.length[other])) for other in predecessors]
        for other, begin in nearby:
            near = begin < float(graph.length[lane]) + _REACH and begin + graph.length[other] > -_REACH
            if other not in found and near:
                found[other] = begin
                waiting.append((other, begin, way))
    return list(found.items())


def _successors(graph: LaneGraph, lane: int) -> NDArray[np.int64]:
    return graph.successor[graph.successor_start[lane] : graph.successor_start[lane + 1]]


def _predecessors(graph: LaneGraph, lane: int) -> NDArray[np.int64]:
    """The lanes that lead to a lane."""
    places = np.flatnonzero(graph.successor == lane)
    return np.searchsorted(graph.successor_start, places, side="right") - 1
