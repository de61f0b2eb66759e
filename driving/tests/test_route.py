"""The route is connected, its waypoints are where they should be, and the ego is found on it."""

import math

import numpy as np
import pytest
from athrl_driving.maps import lane_pose, load_town
from athrl_driving.route import Route
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

GRAPH = load_town("town03").graph
ORDINARY = np.flatnonzero(GRAPH.junction < 0)


def new_route(seed: int) -> Route:
    generator = np.random.default_rng(seed)
    lane = int(generator.integers(GRAPH.length.size))
    return Route(GRAPH, lane, float(generator.uniform(0.0, GRAPH.length[lane])), generator)


def drive_on(route: Route, metres: float, lateral: float = 0.0) -> None:
    """Advance along the route in steps of half a metre, `lateral` metres to its right."""
    for _ in range(round(metres / 0.5)):
        x, y, heading = route.poses(np.array([route.position + 0.5]))[0]
        route.advance(x - lateral * math.sin(heading), y + lateral * math.cos(heading))


def successors(lane: int) -> NDArray[np.int64]:
    return GRAPH.successor[GRAPH.successor_start[lane] : GRAPH.successor_start[lane + 1]]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_waypoints_are_the_next_twelve_five_metres_apart(seed: int) -> None:
    route = new_route(seed)
    drive_on(route, 37.0)
    waypoints = route.waypoints()
    assert waypoints.shape == (12, 3)
    first = 5.0 * (math.floor(route.position / 5.0) + 1)
    np.testing.assert_allclose(waypoints, route.poses(first + 5.0 * np.arange(12)))
    steps = np.linalg.norm(np.diff(waypoints[:, :2], axis=0), axis=1)
    assert np.all(steps < 5.0 + 1e-6)
    assert np.all(steps > 4.7)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_every_lane_leads_to_the_next(seed: int) -> None:
    route = new_route(seed)
    for _ in range(5):
        for lane, following in zip(route.lanes[:-1], route.lanes[1:], strict=True):
            assert following == lane or following in successors(lane)
        drive_on(route, 60.0)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(-1.9, 1.9))
def test_the_ego_is_found_where_it_is(seed: int, lateral: float) -> None:
    route = new_route(seed)
    for metres in range(1, 300):
        x, y, heading = route.poses(np.array([float(metres)]))[0]
        route.advance(x - lateral * math.sin(heading), y + lateral * math.cos(heading))
        assert route.position == pytest.approx(metres, abs=1e-6)
        assert route.lateral == pytest.approx(lateral, abs=1e-6)
        assert route.lane == route.lanes_ahead[0]


def test_positions_grow_along_a_long_drive_and_the_route_stays_short() -> None:
    route = new_route(1)
    before = route.position
    for _ in range(300):
        drive_on(route, 10.0)
        assert route.position == pytest.approx(before + 10.0)
        before = route.position
        assert route.starts[-1] - route.position >= 80.0
        assert route.starts[1] > route.position - 20.0 - GRAPH.length.max()
    assert route.lanes.size < 60


def test_exits_are_drawn_at_random_and_repeatably() -> None:
    fork = int(np.argmax(np.diff(GRAPH.successor_start)))
    assert successors(fork).size >= 2

    def exits() -> list[int]:
        drawn = []
        for seed in range(60):
            route = Route(GRAPH, fork, float(GRAPH.length[fork]), np.random.default_rng(seed))
            drawn.append(next(int(lane) for lane in route.lanes if lane != fork))
        return drawn

    drawn = exits()
    assert drawn == exits()
    assert set(drawn) == set(successors(fork).tolist())
    assert min(drawn.count(int(choice)) for choice in successors(fork)) > 60 / successors(fork).size / 3


def test_the_route_stays_in_its_lane_beside_another() -> None:
    pairs = np.flatnonzero((GRAPH.right >= 0) & (GRAPH.length > 100))
    assert pairs.size > 0
    for lane in pairs:
        route = Route(GRAPH, int(lane), 1.0, np.random.default_rng(0))
        drive_on(route, 90.0)
        assert route.lane == lane


def test_heading_of_nearest_waypoint_is_the_routes() -> None:
    bend = int(np.argmax(np.where(GRAPH.junction < 0, np.abs(GRAPH.curvature), 0.0)))
    route = Route(GRAPH, bend, 0.0, np.random.default_rng(0))
    x, y, _ = lane_pose(GRAPH, bend, 6.0)
    route.advance(x, y)
    assert route.heading_of_nearest_waypoint() == pytest.approx(lane_pose(GRAPH, bend, 5.0)[2])
    x, y, _ = lane_pose(GRAPH, bend, 8.0)
    route.advance(x, y)
    assert route.heading_of_nearest_waypoint() == pytest.approx(lane_pose(GRAPH, bend, 10.0)[2])
