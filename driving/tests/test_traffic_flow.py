"""Traffic flows: no vehicle collides, none waits without end."""

from collections.abc import Callable

import numpy as np
import pytest
from athrl_driving.maps import TOWNS, Town, lane_pose, load_town
from athrl_driving.traffic import TrafficRoad
from athrl_driving.traffic.flow import measure_flow, overlapping_pairs
from highway_env.vehicle.kinematics import Vehicle

MAPS = [*sorted(TOWNS), "Town02.xodr", "Town03.xodr", "Town04.xodr"]


@pytest.fixture(scope="module")
def town() -> Town:
    return load_town("town03")


@pytest.mark.parametrize("name", MAPS)
def test_a_hundred_vehicles_flow(load_any: Callable[[str], Town], name: str) -> None:
    dense = "town02" in name.lower()
    for seed in range(3):
        flow = measure_flow(load_any(name), 100, seed, minutes=2.0)
        assert flow.colliding_pairs == 0
        assert flow.share_of_free_flow >= (0.3 if dense else 0.6)
        assert flow.longest_standstill <= (120.0 if dense else 60.0)


@pytest.mark.parametrize("name", ["town02", "town04"])
def test_dense_traffic_does_not_lock_up(name: str) -> None:
    vehicles = {"town02": 130, "town04": 1000}[name]
    flow = measure_flow(load_town(name), vehicles, 0, minutes=2.0)
    assert flow.colliding_pairs == 0
    assert flow.share_of_free_flow >= 0.15


@pytest.mark.parametrize("seed", range(12))
def test_a_standing_ego_is_not_run_over(town: Town, seed: int) -> None:
    """Anywhere: in a street, at a line, in the middle of a junction, across two lanes."""
    random = np.random.default_rng(seed)
    lane = int(random.integers(len(town.graph.length)))
    x, y, heading = lane_pose(town.graph, lane, random.uniform(0.0, town.graph.length[lane]))
    road = TrafficRoad(town, 150, np_random=random)
    ego = Vehicle(road, (x, y), heading + random.choice([0.0, 0.0, 0.4]), speed=0.0)
    road.vehicles.append(ego)
    road.ego_path = np.array([lane])
    road.spawn_background((x, y))
    for _ in range(1200):
        road.act()
        road.step(0.1)
        assert not ego.crashed
    assert overlapping_pairs(road.background) == 0
