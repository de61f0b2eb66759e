"""Queries to an accelerated road have the same results as those to highway-env's own road."""

import copy

import gymnasium
import highway_env
import numpy as np
import pytest
from athrl_accelerate.road import accelerate_road
from athrl_driving.maps import load_town
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

assert highway_env  # importing it registers its environments

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def roads(environment: str, seed: int = 0) -> tuple[Road, Road]:
    env = gymnasium.make(environment).unwrapped
    env.reset(seed=seed)
    plain = env.road
    accelerated = copy.deepcopy(plain)
    accelerate_road(accelerated)
    return plain, accelerated


def numbers(road: Road, found: list) -> list[int | None]:
    things = road.vehicles + road.objects
    return [
        None if thing is None else next(i for i, other in enumerate(things) if other is thing)
        for thing in found
    ]


@pytest.mark.parametrize("environment", ["highway-fast-v0", "merge-v1", "roundabout-v1", "intersection-v2"])
def test_close_objects_are_those_of_the_slow_road(environment: str) -> None:
    plain, accelerated = roads(environment)
    questions = [
        {"distance": 200.0, "count": 4, "see_behind": False},
        {"distance": 60.0, "count": None, "see_behind": True, "sort": False},
        {"distance": 1000.0, "count": 3, "vehicles_only": True},
    ]
    for question in questions:
        for one, other in zip(plain.vehicles, accelerated.vehicles, strict=True):
            expected = numbers(plain, plain.close_objects_to(one, **question))
            assert numbers(accelerated, accelerated.close_objects_to(other, **question)) == expected
    stranger = Vehicle(accelerated, plain.vehicles[0].position)
    expected = numbers(plain, plain.close_vehicles_to(stranger, 100.0))
    assert numbers(accelerated, accelerated.close_vehicles_to(stranger, 100.0)) == expected


@pytest.mark.parametrize("environment", ["highway-fast-v0", "merge-v0", "merge-v1", "roundabout-v1"])
def test_neighbours_are_those_of_the_slow_road(environment: str) -> None:
    plain, accelerated = roads(environment)
    for index in [None, *plain.network.lanes_dict()]:
        for one, other in zip(plain.vehicles, accelerated.vehicles, strict=True):
            expected = numbers(plain, list(plain.neighbour_vehicles(one, index)))
            assert numbers(accelerated, list(accelerated.neighbour_vehicles(other, index))) == expected


def test_of_vehicles_side_by_side_the_last_is_in_front_and_the_first_behind() -> None:
    for behind in (False, True):
        plain = Road(RoadNetwork.straight_road_network(1))
        plain.vehicles = [Vehicle(plain, [100.0, 0.0])]
        plain.vehicles += [Vehicle(plain, [80.0 if behind else 120.0, y]) for y in (-0.5, 0.0, 0.5)]
        plain.vehicles += [Vehicle(plain, [100.0, 0.0])] if behind else []
        accelerated = copy.deepcopy(plain)
        accelerate_road(accelerated)
        expected = numbers(plain, list(plain.neighbour_vehicles(plain.vehicles[0])))
        assert expected == ([4, 1] if behind else [3, None])
        assert numbers(accelerated, list(accelerated.neighbour_vehicles(accelerated.vehicles[0]))) == expected


def poses(network: RoadNetwork, count: int, random: np.random.Generator) -> list[tuple[np.ndarray, float]]:
    """Poses on the lanes, beside them and far away from all."""
    found = []
    lanes = network.lanes_list()
    for _ in range(count):
        lane = lanes[random.integers(len(lanes))]
        along = random.uniform(-10, lane.length + 10)
        spread = random.choice([0.5, 10.0, 200.0])
        found.append((lane.position(along, random.normal() * spread), random.uniform(-7, 7)))
    return found


@pytest.mark.parametrize("name", ["roundabout-v1", "racetrack-v1", "town03"])
def test_the_closest_lane_is_that_of_the_slow_network(name: str) -> None:
    plain = RoadNetwork()
    source = load_town(name) if name.startswith("town") else gymnasium.make(name).unwrapped.road
    plain.graph = source.network.graph
    road = Road(copy.deepcopy(plain))
    accelerate_road(road)
    assert len(road.network.compiled.arrays.cell_lane), "there is no grid to test"
    for position, heading in poses(plain, 400, np.random.default_rng(0)):
        expected = plain.get_closest_lane_index(position, heading)
        assert road.network.get_closest_lane_index(position, heading) == expected


def test_a_lane_that_is_added_is_found() -> None:
    network = RoadNetwork.straight_road_network(2)
    road = Road(network)
    accelerate_road(road)
    lane = copy.deepcopy(network.get_lane(("0", "1", 0)))
    lane.start, lane.end = lane.start + np.array([0, 50]), lane.end + np.array([0, 50])
    network.add_lane("2", "3", lane)
    assert network.get_closest_lane_index(np.array([10.0, 50.0]), 0.0) == ("2", "3", 0)
