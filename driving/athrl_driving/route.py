"""The ego's route: lanes drawn at random where the road forks, waypoints 5 m apart, the ego's place on it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .compilation import compiled
from .maps.geometry import lane_pose, lane_project
from .maps.lane_graph import LaneGraph

WAYPOINT_SPACING = 5.0
"""Distance between waypoints along the route, m."""

WAYPOINTS_KNOWN = 12
"""Waypoints ahead that the ego knows."""

KEPT_BEHIND = 20.0
"""Metres of route behind the ego that are kept, enough for the window of the observation."""

_KNOWN_AHEAD = (WAYPOINTS_KNOWN + 1) * WAYPOINT_SPACING + 15.0


@compiled
def follow_lanes(
    graph: LaneGraph, lanes: NDArray[np.int64], index: int, x: float, y: float
) -> tuple[int, float, float]:
    """Place of a point on a path that was at its lane `index` before: (index, metres into it, lateral)."""
    position, lateral = lane_project(graph, lanes[index], x, y)
    while index + 1 < lanes.size and position > graph.length[lanes[index]]:
        index += 1
        position, lateral = lane_project(graph, lanes[index], x, y)
    return index, position, lateral


@compiled
def poses_on_lanes(
    graph: LaneGraph,
    lanes: NDArray[np.int64],
    starts: NDArray[np.float64],
    positions: NDArray[np.float64],
) -> NDArray[np.float64]:
    """float64 [n, 3]: x, y, heading at ascending positions (m) on a path whose lanes begin at `starts`."""
    poses = np.empty((positions.size, 3))
    index = 0
    for row in range(positions.size):
        while index + 1 < lanes.size and positions[row] >= starts[index + 1]:
            index += 1
        x, y, heading = lane_pose(graph, lanes[index], positions[row] - starts[index])
        poses[row, 0], poses[row, 1], poses[row, 2] = x, y, heading
    return poses


class Route:
    """Where the ego is to go, and where on it the ego is.

    Positions are metres along the route from where the episode began; it grows ahead as the ego drives.
    On a road of several lanes it stays in its lane; at a fork the exit is drawn with `generator`.
    """

    def __init__(
        self, graph: LaneGraph, lane: int, lane_position: float, generator: np.random.Generator
    ) -> None:
        self.graph = graph
        self._generator = generator
        self.lanes = np.array([lane], dtype=np.int64)
        self.starts = np.array([-lane_position, graph.length[lane] - lane_position])
        self.index = 0
        self.position = 0.0
        self.lateral = 0.0
        self._extend()

    @property
    def lane(self) -> int:
        """Row of the lane that the ego is on."""
        return int(self.lanes[self.index])

    @property
    def lanes_ahead(self) -> NDArray[np.int64]:
        """int64 [n]: the ego's lane and those that follow."""
        return self.lanes[self.index :]

    def advance(self, x: float, y: float) -> bool:
        """Take the ego's new place, m; whether it is on another lane than before."""
        index, position, self.lateral = follow_lanes(self.graph, self.lanes, self.index, x, y)
        self.position = float(self.starts[index] + position)
        if index == self.index:
            return False
        self.index = int(index)
        self._forget()
        self._extend()
        return True

    def waypoints(self) -> NDArray[np.float64]:
        """float64 [12, 3]: x, y (m) and heading (rad) of the next waypoints."""
        first = math.floor(self.position / WAYPOINT_SPACING) + 1 - self._first_waypoint
        return self._waypoints[first : first + WAYPOINTS_KNOWN].copy()

    def heading_of_nearest_waypoint(self) -> float:
        """Heading of the waypoint nearest to the ego along the route, rad."""
        nearest = round(self.position / WAYPOINT_SPACING) - self._first_waypoint
        return float(self._waypoints[max(nearest, 0), 2])

    def poses(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """float64 [n, 3]: x, y (m) and heading (rad) at ascending positions on the route, m."""
        return poses_on_lanes(self.graph, self.lanes, self.starts, positions)

    def _extend(self) -> None:
        """Draw lanes until enough of the route is known."""
        graph, lanes, starts = self.graph, list(self.lanes), list(self.starts)
        while starts[-1] - self.position < _KNOWN_AHEAD + graph.length[lanes[self.index]]:
            lane = lanes[-1]
            choices = graph.successor[graph.successor_start[lane] : graph.successor_start[lane + 1]]
            if choices.size == 0:
                raise ValueError(
                    f"lane {lane} of the map leads nowhere, a route needs a way on from every lane"
                )
            lanes.append(choices[self._generator.integers(choices.size)])
            starts.append(starts[-1] + graph.length[lanes[-1]])
        self.lanes = np.array(lanes, dtype=np.int64)
        self.starts = np.array(starts)
        self._first_waypoint = math.ceil(starts[0] / WAYPOINT_SPACING)
        numbers = np.arange(self._first_waypoint, math.floor(starts[-1] / WAYPOINT_SPACING) + 1)
        self._waypoints = self.poses(numbers * WAYPOINT_SPACING)

    def _forget(self) -> None:
        """Drop the lanes that lie far behind."""
        behind = int(np.searchsorted(self.starts[1:], self.position - KEPT_BEHIND))
        behind = min(behind, self.index)
        self.lanes, self.starts = self.lanes[behind:], self.starts[behind:]
        self.index -= behind
