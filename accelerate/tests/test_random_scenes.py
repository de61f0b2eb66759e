"""For any roads, vehicles and states, one accelerated frame equals highway-env's."""

import copy

import numpy as np
import pytest
from athrl_accelerate.parity import difference, differences
from athrl_accelerate.road import accelerate_road
from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import AggressiveVehicle, DefensiveVehicle, IDMVehicle, LinearVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.dynamics import BicycleVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Landmark, Obstacle
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

CLASSES = (
    IDMVehicle,
    IDMVehicle,
    IDMVehicle,
    LinearVehicle,
    AggressiveVehicle,
    DefensiveVehicle,
    ControlledVehicle,
    MDPVehicle,
    Vehicle,
    BicycleVehicle,
)
TOWN = 60.0
"""m, the side of the square that holds everything: small, so that there are many collisions."""


def random_lane(
    random: np.random.Generator, start: np.ndarray, end: np.ndarray, beside: float
) -> AbstractLane:
    traits = {
        "width": random.uniform(2.5, 5.0),
        "speed_limit": None if random.random() < 0.1 else random.uniform(5.0, 30.0),
        "priority": int(random.integers(0, 3)),
        "forbidden": bool(random.random() < 0.1),
    }
    direction = (end - start) / np.linalg.norm(end - start)
    shift = beside * np.array([-direction[1], direction[0]])
    kind = random.integers(3)
    if kind == 0:
        return StraightLane(start + shift, end + shift, **traits)
    if kind == 1:
        waves = random.uniform(0.5, 4.0), 2 * np.pi / random.uniform(20, 80), random.uniform(0, 2 * np.pi)
        return SineLane(start + shift, end + shift, *waves, **traits)
    clockwise = bool(random.integers(2))
    begin, sweep = random.uniform(-np.pi, np.pi), random.uniform(0.3, 6.0) * (1 if clockwise else -1)
    radius = random.uniform(6.0, 30.0) + abs(beside)
    return CircularLane((start + end) / 2, radius, begin, begin + sweep, clockwise, **traits)


def random_network(random: np.random.Generator) -> RoadNetwork:
    network = RoadNetwork()
    nodes = {str(number): random.uniform(0, TOWN, 2) for number in range(random.integers(2, 6))}
    for _ in range(random.integers(1, 9)):
        origin, destination = random.choice(list(nodes), 2, replace=False)
        for number in range(random.integers(1, 4)):
            lane = random_lane(random, nodes[origin], nodes[destination], 4.0 * number)
            network.add_lane(str(origin), str(destination), lane)
    return network


def random_route(random: np.random.Generator, network: RoadNetwork, vehicle: ControlledVehicle) -> None:
    if random.random() < 0.3:
        return
    origin, destination, number = vehicle.target_lane_index
    route = [(origin, destination, number if random.random() < 0.5 else None)]
    while len(route) < 5 and network.graph.get(destination):
        origin, destination = destination, str(random.choice(list(network.graph[destination])))
        number = int(random.integers(len(network.graph[origin][destination])))
        route.append((origin, destination, number if random.random() < 0.7 else None))
    vehicle.route = route[random.integers(2) :]


def add_vehicle(random: np.random.Generator, road: Road) -> None:
    network = road.network
    index = network.random_lane_index(random)
    lane = network.get_lane(index)
    along = random.uniform(-3.0, lane.length + 3.0)
    position = lane.position(along, random.normal() * 1.5)
    heading = lane.heading_at(along) + random.normal() * 0.3
    cls = CLASSES[random.integers(len(CLASSES))]
    speed = random.choice([0.0, random.uniform(-2, 2), random.uniform(0, 45)], p=[0.1, 0.3, 0.6])
    vehicle = cls(road, position, heading, float(speed))
    vehicle.action = {"steering": random.normal() * 0.5, "acceleration": random.normal() * 3.0}
    vehicle.crashed = bool(random.random() < 0.1)
    vehicle.check_collisions = bool(random.random() < 0.9)
    if random.random() < 0.1:
        vehicle.impact = random.normal(size=2)
    if isinstance(vehicle, BicycleVehicle):
        vehicle.lateral_speed, vehicle.yaw_rate = random.normal(), random.normal()
    if isinstance(vehicle, ControlledVehicle):
        if random.random() < 0.4:
            vehicle.target_lane_index = network.random_lane_index(random)
        vehicle.target_speed = random.uniform(-1, 30)
        random_route(random, network, vehicle)
    if isinstance(vehicle, IDMVehicle):
        vehicle.timer = random.uniform(0, 1.5)
        vehicle.enable_lane_change = bool(random.random() < 0.8)
        vehicle.randomize_behavior()
        vehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED = random.uniform(0, 50)
        vehicle.POLITENESS = random.uniform(0, 1)
    road.vehicles.append(vehicle)


def random_road(seed: int, vehicles: int, objects: int, regulated: bool, connected: bool) -> Road:
    random = np.random.default_rng(seed)
    network = random_network(random)
    road = (RegulatedRoad if regulated else Road)(
        network, np_random=random, neighbour_vehicles_connected_lanes=connected
    )
    for _ in range(vehicles):
        add_vehicle(random, road)
    for _ in range(objects):
        cls = Obstacle if random.random() < 0.7 else Landmark
        road.objects.append(cls(road, random.uniform(0, TOWN, 2), random.uniform(-3, 3)))
    return road


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 2**32 - 1),
    vehicles=st.integers(1, 14),
    objects=st.integers(0, 3),
    regulated=st.booleans(),
    connected=st.booleans(),
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_highway_one_frame_of_any_scene_is_that_of_the_slow_road(
    seed: int, vehicles: int, objects: int, regulated: bool, connected: bool
) -> None:
    plain = random_road(seed, vehicles, objects, regulated, connected)
    if regulated:
        plain.steps = 6  # the rules are due at the next frame
    accelerated = copy.deepcopy(plain)
    accelerate_road(accelerated)
    refused = 0
    for road in (plain, accelerated):
        try:
            road.act()
            road.step(1 / 15)
        except IndexError:
            refused += 1
    assert refused in (0, 2), "only one of the roads raises for a route to a lane that is not there"
    # One frame only: a push leaves boxes that just touch, and then rounding says whether they still do.
    if not refused:
        assert difference(plain, accelerated) < 1e-9, differences(plain, accelerated)[:3]
