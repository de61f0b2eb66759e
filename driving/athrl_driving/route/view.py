"""A route as an object for Python: drivers, scenes, tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import compiled, entry, prepare
from athrl_driving.maps.lane_graph import Integers, LaneGraph
from athrl_driving.route.search import search_back
from athrl_driving.route.state import LENGTH, START_POSITION, RouteState, new_routes
from athrl_driving.route.tracking import (
    LANES_AHEAD,
    environment_route,
    follow,
    heading_of_nearest_waypoint,
    lanes_ahead,
    poses_on_route,
    start_routes,
    waypoints,
)

_NO_PLAN = np.empty(0, dtype=np.int64)


class Route:
    """The ego's route and the ego's position on it: a view of one environment's part of the arrays.

    Positions are metres along the route from where the episode began; it grows ahead as the ego drives.
    """

    def __init__(
        self, graph: LaneGraph, lane: int, lane_position: float, generator: np.random.Generator
    ) -> None:
        """Start a route in its own arrays with random turns, `lane_position` metres along a lane."""
        self._attach(graph, new_routes(graph, 1), 0)
        seed = np.uint64(generator.integers(2**63))
        start_routes(graph, self.routes, 0, lane, float(lane_position), seed, _NO_PLAN, 0.0)

    @classmethod
    def of_environment(cls, graph: LaneGraph, routes: RouteState, environment: int) -> Route:
        """View the route of one environment of a batch."""
        route = cls.__new__(cls)
        route._attach(graph, routes, environment)
        return route

    @classmethod
    def planned(
        cls, graph: LaneGraph, plan: Integers, start: float, destination: float, seed: int = 0
    ) -> Route:
        """Start a route in its own arrays along a plan.

        `start` is m along the plan's first lane, `destination` is m along its last.
        """
        route = cls.of_environment(graph, new_routes(graph, 1), 0)
        start_routes(graph, route.routes, 0, int(plan[0]), start, np.uint64(seed), plan, destination)
        return route

    @staticmethod
    def prepare(graph: LaneGraph, routes: RouteState) -> None:
        """Compile or load what drivers and viewers call, so that they do not wait for it later."""
        prepare(_waypoints, routes, 0)
        prepare(_lanes_ahead, graph, routes, 0, np.empty(LANES_AHEAD, dtype=np.int64))
        prepare(poses_on_route, routes.segments[0], 0, np.empty(0))
        prepare(search_back, graph, 0, 0, 0.0, 0.0)

    def _attach(self, graph: LaneGraph, routes: RouteState, environment: int) -> None:
        self.graph = graph
        self.routes = routes
        self.environment = environment

    @property
    def position(self) -> float:
        """The ego's position along the route, m."""
        return float(self.routes.position[self.environment])

    @property
    def lateral(self) -> float:
        """How far the ego is to the right of the route, m."""
        return float(self.routes.lateral[self.environment])

    @property
    def arrival(self) -> float:
        """The destination's place along the route, m; infinite without one or while it is far ahead."""
        return float(self.routes.arrival[self.environment])

    @property
    def end(self) -> float:
        """Where no lane follows, as at the map's edge, m along the route; infinite while it goes on."""
        return float(self.routes.end[self.environment])

    @property
    def segments(self) -> NDArray[np.float64]:
        """float64 [n, 6]: x, y, heading, curvature, length, metres along the route of each known segment."""
        return self.routes.segments[self.environment, : self._count]

    @property
    def lanes(self) -> NDArray[np.int64]:
        """int64 [n]: the lane of each segment; during a lane change the new lane."""
        return self.routes.lane[self.environment, : self._count]

    @property
    def starts(self) -> NDArray[np.float64]:
        """float64 [n + 1]: where along the route each segment starts and the last one ends, m."""
        segments = self.segments
        end = segments[-1, START_POSITION] + segments[-1, LENGTH]
        return np.append(segments[:, START_POSITION], end)

    @property
    def index(self) -> int:
        """The segment that the ego is on."""
        return int(self.routes.ego_segment[self.environment])

    @property
    def lane(self) -> int:
        """The lane that the ego is on or is changing to."""
        return int(self.lanes[self.index])

    @property
    def lanes_ahead(self) -> NDArray[np.int64]:
        """int64 [n]: the ego's lane and those that follow."""
        lanes = np.empty(LANES_AHEAD, dtype=np.int64)
        _lanes_ahead(self.graph, self.routes, self.environment, lanes)
        return lanes[lanes >= 0]

    def advance(self, x: float, y: float) -> bool:
        """Update the route for the ego's new place, m; tell whether it is on another lane than before."""
        lane = self.lane
        _follow(self.graph, self.routes, self.environment, x, y)
        return self.lane != lane

    def waypoints(self) -> NDArray[np.float64]:
        """float64 [12, 3]: x, y (m) and heading (rad) of the next waypoints."""
        return _waypoints(self.routes, self.environment)

    def heading_of_nearest_waypoint(self) -> float:
        """Heading of the waypoint nearest to the ego along the route, rad."""
        return float(_heading(self.routes, self.environment))

    def place_on_lane(self, position: float) -> float:
        """Return the metres along the lane at a position (m); approximate during a lane change."""
        segment = int(np.searchsorted(self.starts[1:-1], position, side="right"))
        start = self.segments[segment, START_POSITION]
        return float(self.routes.lane_start[self.environment, segment] + position - start)

    def poses(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """float64 [n, 3]: x, y (m) and heading (rad) at ascending positions on the route, m."""
        return poses_on_route(self.routes.segments[self.environment], self._count, positions)

    @property
    def _count(self) -> int:
        return int(self.routes.segment_count[self.environment])


@entry
def _follow(graph: LaneGraph, routes: RouteState, environment: int, x: float, y: float) -> None:
    follow(by_reference(graph), by_reference(environment_route(by_reference(routes), environment)), x, y)


@compiled
def _waypoints(routes: RouteState, environment: int) -> NDArray[np.float64]:
    return waypoints(environment_route(routes, environment))


@compiled
def _heading(routes: RouteState, environment: int) -> float:
    return heading_of_nearest_waypoint(environment_route(routes, environment))


@compiled
def _lanes_ahead(graph: LaneGraph, routes: RouteState, environment: int, lanes: Integers) -> None:
    lanes_ahead(graph, environment_route(routes, environment), lanes)
