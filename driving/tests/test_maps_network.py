"""The network of a town is one on which highway-env's own vehicles drive."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from athrl_driving.maps import TOWNS, Town
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle


@pytest.fixture(scope="module", params=[*TOWNS, "Town03.xodr", "Town04.xodr"])
def town(request: pytest.FixtureRequest, load_any: Callable[[str], Town]) -> Town:
    return load_any(request.param)


def test_every_lane_is_one_of_highway_envs(town: Town) -> None:
    lanes = town.network.lanes_dict()
    assert set(lanes) == set(town.lane_indices)
    assert {type(lane) for lane in lanes.values()} == {CircularLane, StraightLane}


def test_copies_of_a_lane_share_an_index(town: Town) -> None:
    graph = town.graph
    place = np.stack(
        [graph.start_x, graph.start_y, graph.start_heading, graph.curvature, graph.length], axis=1
    )
    first: dict[tuple[str, str, int], int] = {}
    for lane, index in enumerate(town.lane_indices):
        np.testing.assert_array_equal(place[first.setdefault(index, lane)], place[lane])
    ordinary = [index for lane, index in enumerate(town.lane_indices) if graph.movement[lane] < 0]
    assert len(set(ordinary)) == len(ordinary)


def test_parallel_lanes_are_one_road_from_left_to_right(town: Town) -> None:
    graph = town.graph
    for lane in np.flatnonzero(graph.right >= 0).tolist():
        start, end, identifier = town.lane_indices[lane]
        assert town.lane_indices[graph.right[lane]] == (start, end, identifier + 1)


def test_lanes_that_follow_each_other_meet_in_a_node(town: Town) -> None:
    graph = town.graph
    for lane, (_, end, _) in enumerate(town.lane_indices):
        for after in graph.successor[graph.successor_start[lane] : graph.successor_start[lane + 1]]:
            assert town.lane_indices[after][0] == end


def test_routes_are_found_by_a_real_search(town: Town) -> None:
    nodes = list(town.network.graph)
    rng = np.random.default_rng(0)
    for _ in range(50):
        start, goal = rng.choice(nodes, 2, replace=False)
        path = town.network.shortest_path(start, goal)
        assert path[0] == start
        assert path[-1] == goal
        assert all(after in town.network.graph[node] for node, after in itertools.pairwise(path))
    assert town.network.shortest_path(nodes[0], nodes[0]) == []
    assert town.network.shortest_path(nodes[0], "nowhere") == []


def test_highway_envs_own_vehicles_drive_with_random_routes(town: Town) -> None:
    rng = np.random.default_rng(1)
    road = Road(network=town.network, np_random=np.random.RandomState(1))
    streets = np.flatnonzero((town.graph.movement < 0) & (town.graph.length > 20.0))
    nodes = list(town.network.graph)
    for lane in rng.choice(streets, 6, replace=False):
        vehicle = IDMVehicle.make_on_lane(road, town.lane_indices[lane], longitudinal=8.0, speed=8.0)
        vehicle.target_speed = 8.0
        vehicle.plan_route_to(str(rng.choice(nodes)))
        road.vehicles.append(vehicle)
    travelled = np.zeros(len(road.vehicles))
    lanes: list[set[tuple[str, str, int]]] = [set() for _ in road.vehicles]
    for _ in range(300):
        road.act()
        road.step(0.1)
        for place, vehicle in enumerate(road.vehicles):
            travelled[place] += vehicle.speed * 0.1
            lanes[place].add(vehicle.lane_index)
            _, lateral = vehicle.lane.local_coordinates(vehicle.position)
            assert abs(lateral) < 6.0
    assert np.median(travelled) > 100.0
    assert sum(len(seen) > 1 for seen in lanes) >= 3
