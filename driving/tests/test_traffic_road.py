"""What a road with traffic promises to highway-env and to an environment."""

import math

import numpy as np
import pygame
import pytest
from athrl_driving.maps import Town, lane_pose, load_town
from athrl_driving.traffic import TrafficRoad
from highway_env.road.graphics import RoadGraphics, WorldSurface
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.graphics import VehicleGraphics
from highway_env.vehicle.kinematics import Vehicle


@pytest.fixture(scope="module")
def town() -> Town:
    return load_town("town03")


def busy_road(town: Town, seed: int, vehicles: int = 100) -> TrafficRoad:
    road = TrafficRoad(town, vehicles, np_random=np.random.default_rng(seed))
    road.spawn_background()
    return road


def states(road: TrafficRoad, ticks: int) -> np.ndarray:
    for _ in range(ticks):
        road.act()
        road.step(0.1)
    background = road.background
    return np.stack([background.x, background.y, background.heading, background.speed])


def test_the_same_seed_gives_the_same_episode(town: Town) -> None:
    first, second = states(busy_road(town, 5), 300), states(busy_road(town, 5), 300)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, states(busy_road(town, 6), 300))


def test_looking_changes_nothing(town: Town) -> None:
    def episode(looks: bool) -> np.ndarray:
        road = TrafficRoad(town, 60, np_random=np.random.default_rng(1))
        lane = int(town.movements.origin[0])
        x, y, heading = lane_pose(town.graph, lane, 20.0)
        road.vehicles.append(Vehicle(road, (x, y), heading, speed=6.0))
        road.ego_path = np.array([lane, *town.movements.lane[:1]])
        road.spawn_background((x, y))
        for _ in range(100):
            road.act()
            if looks:
                road.leader_of_ego()
            road.step(0.1)
        return states(road, 0)

    assert np.array_equal(episode(looks=True), episode(looks=False))


def test_the_start_of_the_ego_is_clear(town: Town) -> None:
    lane = int(np.argmax(town.graph.length))
    x, y, _ = lane_pose(town.graph, lane, 60.0)
    for seed in range(20):
        road = TrafficRoad(town, 300, np_random=np.random.default_rng(seed))
        road.spawn_background(keep_clear_of=(x, y))
        assert np.hypot(road.background.x - x, road.background.y - y).min() > 8.0


def test_too_many_vehicles_are_refused_in_one_line(town: Town) -> None:
    with pytest.raises(ValueError, match=r"vehicles_count is 5000, but the town has room for \d+ at most"):
        TrafficRoad(town, 5000, np_random=np.random.default_rng(0))
    with pytest.raises(ValueError, match="vehicles_count is -1"):
        TrafficRoad(town, -1, np_random=np.random.default_rng(0))


def test_background_vehicles_are_highway_envs(town: Town) -> None:
    road = busy_road(town, 2)
    states(road, 50)
    assert len(road.vehicles) == 100
    for index, vehicle in enumerate(road.vehicles):
        assert isinstance(vehicle, IDMVehicle)
        s, lateral = vehicle.lane.local_coordinates(vehicle.position)
        assert lateral == pytest.approx(0.0, abs=1e-6)
        assert s == pytest.approx(road.background.s[index], abs=1e-6)
        assert vehicle.lane_index == town.lane_indices[road.background.lane[index]]
        assert abs(math.remainder(vehicle.heading - vehicle.lane.heading_at(s), 2 * math.pi)) < 1e-6
        assert vehicle.speed == road.background.speed[index]
        assert vehicle.polygon().shape == (5, 2)


def test_highway_envs_renderer_draws_the_traffic(town: Town) -> None:
    pygame.init()
    road = busy_road(town, 3)
    surface = WorldSurface((600, 600), 0, pygame.Surface((600, 600)))
    surface.move_display_window_to(road.vehicles[0].position)
    RoadGraphics.display(road, surface)
    RoadGraphics.display_traffic(road, surface, offscreen=True)
    image = pygame.surfarray.array3d(surface)
    assert (image == VehicleGraphics.BLUE).all(axis=2).any()
    assert (image == WorldSurface.WHITE).all(axis=2).any()


def test_hitting_a_vehicle_is_a_crash_of_both(town: Town) -> None:
    road = TrafficRoad(town, 30, np_random=np.random.default_rng(0))
    road.spawn_background()
    target = road.vehicles[7]
    behind = target.position - 12.0 * target.direction
    ego = Vehicle(road, behind, target.heading, speed=30.0)
    road.vehicles.insert(0, ego)
    for _ in range(20):
        road.act()
        road.step(0.1)
        if ego.crashed:
            break
    assert ego.crashed
    assert target.crashed
    assert sum(vehicle.crashed for vehicle in road.vehicles[1:]) == 1


def test_a_road_without_background_works(town: Town) -> None:
    road = TrafficRoad(town, 0, np_random=np.random.default_rng(0))
    x, y, heading = lane_pose(town.graph, 0, 5.0)
    ego = Vehicle(road, (x, y), heading, speed=5.0)
    road.vehicles.append(ego)
    road.spawn_background()
    road.ego_path = np.array([0])
    assert road.leader_of_ego() == (math.inf, 0.0)
    road.act()
    road.step(0.1)
    assert not ego.crashed
    assert math.hypot(ego.position[0] - x, ego.position[1] - y) == pytest.approx(0.5)
