"""Traffic flows: nobody collides, nobody waits for ever."""

import numpy as np
import pytest
from athrl_driving.maps import Town, lane_pose, load_town
from athrl_driving.traffic import Background, TrafficRoad
from athrl_driving.traffic.collision import rectangles_touch
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from numba import njit

TEN_MINUTES = 6000
SIZE = (IDMVehicle.LENGTH, IDMVehicle.WIDTH)


@pytest.fixture(scope="module")
def town() -> Town:
    return load_town("town03")


@njit
def touching_pairs(background: Background) -> int:
    pairs = 0
    for i in range(background.x.shape[0]):
        for j in range(i):
            if abs(background.x[i] - background.x[j]) > 6.0 or abs(background.y[i] - background.y[j]) > 6.0:
                continue
            one = (background.x[i], background.y[i], background.heading[i])
            other = (background.x[j], background.y[j], background.heading[j])
            if rectangles_touch(*one, *SIZE, *other, *SIZE):
                pairs += 1
    return pairs


def drive(town: Town, vehicles: int, seed: int) -> tuple[float, float, int]:
    """Return mean speed (m/s), longest standstill (s) and touching pairs over ten minutes."""
    road = TrafficRoad(town, vehicles, np_random=np.random.default_rng(seed))
    road.spawn_background()
    background = road.background
    still, longest, touching, speeds = np.zeros(vehicles), 0.0, touching_pairs(background), 0.0
    for _ in range(TEN_MINUTES):
        road.step(0.1)
        still = np.where(background.speed < 0.1, still + 0.1, 0.0)
        longest = max(longest, still.max())
        speeds += background.speed.mean()
        touching += touching_pairs(background)
    return speeds / TEN_MINUTES, longest, touching


@pytest.fixture(scope="module")
def free_flow(town: Town) -> float:
    """Mean speed of vehicles that are alone in the town."""
    return float(np.mean([drive(town, 1, seed)[0] for seed in range(4)]))


@pytest.mark.parametrize("seed", range(4))
def test_a_hundred_vehicles_flow_for_ten_minutes(town: Town, free_flow: float, seed: int) -> None:
    speed, longest_standstill, touching = drive(town, 100, seed)
    assert touching == 0
    assert longest_standstill <= 60.0
    assert speed >= 0.6 * free_flow


def test_dense_traffic_does_not_lock_up(town: Town, free_flow: float) -> None:
    speed, _, touching = drive(town, 300, 0)
    assert touching == 0
    assert speed >= 0.2 * free_flow


@pytest.mark.parametrize("seed", range(12))
def test_a_standing_ego_is_not_run_over(town: Town, seed: int) -> None:
    """Anywhere: in a street, at a line, in the middle of a junction, across two lanes."""
    random = np.random.default_rng(seed)
    row = int(random.integers(len(town.graph.length)))
    x, y, heading = lane_pose(town.graph, row, random.uniform(0.0, town.graph.length[row]))
    road = TrafficRoad(town, 150, np_random=random)
    ego = Vehicle(road, (x, y), heading + random.choice([0.0, 0.0, 0.4]), speed=0.0)
    road.vehicles.append(ego)
    road.ego_path = np.array([row])
    road.spawn_background((x, y))
    for _ in range(1200):
        road.act()
        road.step(0.1)
        assert not ego.crashed
    assert touching_pairs(road.background) == 0
