"""What a driver needs to know to change lanes: where the route does it next, and who drives over there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.drivers.driver import DrivenTown
from athrl_driving.maps.lane_graph import LaneGraph

LOOK_AHEAD = 50.0
"""Metres before a lane change at which a driver begins to look."""

_REACH = 60.0


class LaneChange(NamedTuple):
    """The next lane change on the route and the traffic on the lane that it leads to."""

    distance: float
    """m from the ego's centre to where it begins; negative while it is under way."""
    gap_ahead: float
    """m from bumper to bumper to the next vehicle on that lane, seen from beside it; inf without one."""
    speed_ahead: float
    """m/s"""
    gap_behind: float
    """m to the vehicle behind, negative where it is beside the ego; inf without one."""
    speed_behind: float
    """m/s"""


def next_lane_change(env: DrivenTown) -> LaneChange | None:
    """Look at the next lane change on the route, or None where none is near.

    It is over when the ego's centre has crossed the line between the lanes.
    """
    graph, route = env.town.graph, env.route
    lanes, starts, index = route.lanes, route.starts, route.index
    if route.lanes_ahead[0] != lanes[index]:
        # Under way: the route already runs on the new lane, the ego is still on the old one.
        return _look(env, int(lanes[index]), route.place_on_row(route.position), -1.0)
    for place in range(index + 1, lanes.size):
        distance = float(starts[place]) - route.position
        if distance > LOOK_AHEAD:
            break
        if lanes[place] in (graph.left[lanes[place - 1]], graph.right[lanes[place - 1]]):
            station = route.place_on_row(float(starts[place])) - distance
            return _look(env, int(lanes[place]), station, distance)
    return None


def _look(env: DrivenTown, row: int, station: float, distance: float) -> LaneChange:
    """Find the vehicles around a place (`station` m along a row, maybe before or behind its ends)."""
    ego, others = env.vehicle, env.road.background
    ahead, behind = (math.inf, 0.0), (math.inf, 0.0)
    for lane, start in _rows_around(env.town.graph, row):
        for vehicle in np.flatnonzero(others.lane == lane):
            along = start + float(others.s[vehicle]) - station
            gap = abs(along) - 0.5 * (ego.LENGTH + float(others.length[vehicle]))
            seen = (gap, float(others.speed[vehicle]))
            if along >= 0.0:
                ahead = min(ahead, seen)
            else:
                behind = min(behind, seen)
    return LaneChange(distance, *ahead, *behind)


def _rows_around(graph: LaneGraph, row: int) -> list[tuple[int, float]]:
    """The rows before and after a row within reach, each with the metres from that row's start to its own."""
    found = {row: 0.0}
    waiting = [(row, 0.0, 1), (row, 0.0, -1)]
    while waiting:
        present, start, way = waiting.pop()
        if way > 0:
            end = start + float(graph.length[present])
            nearby = [(int(other), end) for other in _successors(graph, present)]
        else:
            nearby = [(int(other), start - float(graph.length[other])) for other in _leading(graph, present)]
        for other, begin in nearby:
            near = begin < float(graph.length[row]) + _REACH and begin + graph.length[other] > -_REACH
            if other not in found and near:
                found[other] = begin
                waiting.append((other, begin, way))
    return list(found.items())


def _successors(graph: LaneGraph, row: int) -> NDArray[np.int64]:
    return graph.successor[graph.successor_start[row] : graph.successor_start[row + 1]]


def _leading(graph: LaneGraph, row: int) -> NDArray[np.int64]:
    """The rows that lead to a row."""
    places = np.flatnonzero(graph.successor == row)
    return np.searchsorted(graph.successor_start, places, side="right") - 1
