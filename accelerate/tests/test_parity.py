"""An accelerated road does what highway-env's own does: one frame to rounding, and 100 frames freely."""

import copy

import gymnasium
import highway_env
import numpy as np
import pytest
from athrl_accelerate.parity import copy_state, difference, differences
from athrl_accelerate.road import accelerate_road
from athrl_driving.maps import load_town
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import LaneIndex, Road, RoadNetwork
from highway_env.vehicle.behavior import AggressiveVehicle, DefensiveVehicle, IDMVehicle

assert highway_env  # importing it registers its environments

TOLERANCE = 1e-9
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def peers(environment: str, seed: int, **config: object) -> list[gymnasium.Env]:
    """The same scene twice; the second road is accelerated."""
    pair = [gymnasium.make(environment, config=dict(config)).unwrapped for _ in range(2)]
    for peer in pair:
        peer.reset(seed=seed)
        peer.action_space.seed(seed)
    accelerate_road(pair[1].road)
    return pair


def run(pair: list[gymnasium.Env], frames: int, synchronised: bool) -> None:
    plain, accelerated = (peer.road for peer in pair)
    dt = 1 / pair[0].config["simulation_frequency"]
    for frame in range(frames):
        if synchronised:
            copy_state(plain, accelerated)
        if frame % 8 == 0:
            action = pair[0].action_space.sample()
            for peer in pair:
                peer.action_type.act(action)
        for road in (plain, accelerated):
            road.act()
            road.step(dt)
        assert difference(plain, accelerated) < TOLERANCE, differences(plain, accelerated)[:3]


@pytest.mark.parametrize(
    "environment",
    [
        "highway-fast-v0",
        "merge-v1",
        "merge-generic-v0",
        "roundabout-v0",
        "roundabout-v1",
        "roundabout-generic-v1",
        "intersection-v0",
        "intersection-v1",
        "intersection-v2",
        "intersection-multi-agent-v0",
        "two-way-v0",
        "u-turn-v1",
        "exit-v0",
        "exit-v1",
        "racetrack-v1",
        "parking-v0",
        "lane-keeping-v0",
    ],
)
def test_highway_one_frame_is_that_of_the_slow_road(environment: str) -> None:
    for seed in (0, 1):
        run(peers(environment, seed), 60, synchronised=True)


@pytest.mark.parametrize("vehicles", [AggressiveVehicle, DefensiveVehicle])
def test_highway_linear_vehicles_drive_as_on_the_slow_road(vehicles: type) -> None:
    path = f"{vehicles.__module__}.{vehicles.__name__}"
    run(peers("highway-fast-v0", 2, other_vehicles_type=path, vehicles_density=2), 60, synchronised=True)


@pytest.mark.parametrize("environment", ["highway-v0", "merge-v1", "two-way-v0", "u-turn-v1", "exit-v1"])
def test_highway_free_roads_stay_together_for_100_frames(environment: str) -> None:
    run(peers(environment, 1), 100, synchronised=False)


def random_route(network: RoadNetwork, index: LaneIndex, random: np.random.Generator) -> list[LaneIndex]:
    # With lane numbers: highway-env's rules raise IndexError where a route without them gets narrower.
    route = [index]
    _, node, number = index
    while len(route) < 8 and network.graph.get(node):
        following = random.choice(list(network.graph[node]))
        number = min(number, len(network.graph[node][following]) - 1)
        route.append((node, following, number))
        node = following
    return route


def town_road(name: str, road_class: type[Road], count: int, seed: int) -> Road:
    network = RoadNetwork()
    network.graph = load_town(name).network.graph
    random = np.random.default_rng(seed)
    road = road_class(network, np_random=random)
    indices = list(network.lanes_dict())
    while len(road.vehicles) < count:
        index = indices[random.integers(len(indices))]
        lane = network.get_lane(index)
        position = lane.position(random.uniform(0, lane.length), 0)
        if any(np.hypot(*(other.position - position)) < 8 for other in road.vehicles):
            continue
        heading = lane.heading_at(lane.local_coordinates(position)[0])
        vehicle = IDMVehicle(road, position, heading, speed=random.uniform(0, 10), target_speed=10.0)
        vehicle.randomize_behavior()
        vehicle.route = random_route(network, vehicle.lane_index, random)
        road.vehicles.append(vehicle)
    return road


@pytest.mark.parametrize("road_class", [Road, RegulatedRoad])
def test_highway_one_frame_in_a_town_is_that_of_the_slow_road(road_class: type[Road]) -> None:
    plain = town_road("town03", road_class, 40, seed=0)
    accelerated = copy.deepcopy(plain)
    accelerate_road(accelerated)
    for _ in range(22):
        copy_state(plain, accelerated)
        for road in (plain, accelerated):
            road.act()
            road.step(1 / 15)
        assert difference(plain, accelerated) < TOLERANCE, differences(plain, accelerated)[:3]
    if road_class is RegulatedRoad:
        assert any(vehicle.target_speed == 0 for vehicle in plain.vehicles), "no vehicle had to yield"
