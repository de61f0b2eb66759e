"""Starts and destinations of episodes, random or on the map, and the case studies made of them."""

import gymnasium
import numpy as np
import pytest
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv, TownVectorEnv
from athrl_driving.episode.starts import place_on_map
from athrl_driving.maps import lane_pose, load_town
from athrl_driving.scenarios import SCENARIOS

START, DESTINATION = ("Meadow Road", -1, 5.0), ("Meadow Road", -1, 60.0)


def drive_to_the_end(env: gymnasium.Env, seed: int) -> tuple[bool, bool, dict]:
    env.reset(seed=seed)
    driver = RuleBasedDriver()
    driver.reset(env, seed)
    while True:
        _, _, terminated, truncated, info = env.step(driver.act(env))
        if terminated or truncated:
            return terminated, truncated, info


def test_an_episode_starts_and_ends_where_it_is_told() -> None:
    config = {"start": START, "destination": DESTINATION, "vehicles_count": 0}
    env = TownEnv(config=config)
    lane, s = place_on_map(env.town, START)
    env.reset(seed=1)
    np.testing.assert_allclose(env.vehicle.position, lane_pose(env.town.graph, lane, s)[:2])
    terminated, truncated, info = drive_to_the_end(env, 1)
    assert terminated
    assert not truncated
    assert not info["collision"]
    assert not info["off_lane"]
    assert info["metrics"]["success"] == info["metrics"]["route_completion"] == 1.0
    lane, s = place_on_map(env.town, DESTINATION)
    there = np.array(lane_pose(env.town.graph, lane, s)[:2])
    assert np.linalg.norm(env.vehicle.position - there) < 2.0


def test_a_destination_behind_on_the_lane_beside_is_reached_there_and_not_beside_it() -> None:
    start, destination = ("Circle Road East", -1, 70.0), ("Circle Road East", -2, 20.0)
    config = {"start": start, "destination": destination, "vehicles_count": 0, "episode_ticks": 5000}
    env = TownEnv(config=config)
    _, _, info = drive_to_the_end(env, 1)
    assert info["metrics"]["arrived"] == 1.0
    lane, s = place_on_map(env.town, destination)
    there = np.array(lane_pose(env.town.graph, lane, s)[:2])
    assert np.linalg.norm(env.vehicle.position - there) < 2.0
    assert info["metrics"]["distance"] > 200.0


def test_half_the_way_is_half_the_route() -> None:
    settings = {"start": START, "destination": ("Meadow Road", -1, 195.0), "vehicles_count": 0}
    _, truncated, info = drive_to_the_end(TownEnv(config={**settings, "episode_ticks": 120}), 0)
    assert truncated
    expected = info["metrics"]["distance"] / 190.0
    assert info["metrics"]["route_completion"] == pytest.approx(expected, rel=1e-6)


def test_a_random_destination_is_reached() -> None:
    env = TownEnv(config={"destination": "random", "vehicles_count": 0, "episode_ticks": 5000})
    arrivals = {drive_to_the_end(env, seed)[2]["metrics"]["route_completion"] for seed in (0, 1)}
    assert arrivals == {1.0}


@pytest.mark.parametrize("name", SCENARIOS)
def test_case_studies_start_at_their_place_with_other_traffic_each_time(name: str) -> None:
    vector = gymnasium.make_vec(name, num_envs=2)
    assert isinstance(vector, TownVectorEnv)
    vector.reset(seed=0)
    one, other = vector.environment(0), vector.environment(1)
    np.testing.assert_array_equal(one.vehicle.position, other.vehicle.position)
    assert not np.array_equal(one.road.background.x, other.road.background.x)
    x, y, radius = SCENARIOS[name]["traffic_near"]
    vehicles = one.road.background
    assert vehicles.x.size == SCENARIOS[name]["vehicles_count"]
    assert np.hypot(vehicles.x - x, vehicles.y - y).max() <= radius + 2.0


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"start": "somewhere"}, "start is 'somewhere', it should be None or (road name, lane id, metres"),
        (
            {"start": np.array(["Meadow Road", "1"])},
            "it should be None or (road name, lane id, metres along it)",
        ),
        ({"destination": 7}, 'destination is 7, it should be None, "random" or (road name,'),
        (
            {"start": ("Zzz", 1, 0.0)},
            "the map town03 has no road 'Zzz': load_town(...).road_name has them all",
        ),
        ({"start": ("Meadow Rd", 1, 0.0)}, "has no road 'Meadow Rd', did you mean 'Meadow Road'?"),
        ({"start": ("Meadow Road", 9, 0.0)}, "'Meadow Road' of town03 has no lane 9, its lanes are -1, 1"),
        ({"start": ("Meadow Road", -1, 1e4)}, "is 200.1 m long, not 10000 m"),
        ({"traffic_near": (0.0, 0.0, -1.0)}, "it should be None or (x, y, radius)"),
        ({"vehicles_count": 9000}, "vehicles_count is 9000, but the town has room for"),
        ({"window_side": -2.0}, "window_side is -2"),
    ],
)
def test_what_does_not_fit_the_map_is_refused_in_one_line(config: dict, message: str) -> None:
    with pytest.raises(ValueError, match=r"(?s).+") as error:
        TownEnv(config=config)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_every_lane_of_a_map_is_a_place_on_it() -> None:
    town = load_town("town03")
    for lane in np.flatnonzero(town.graph.junction < 0)[::25].tolist():
        found, s = place_on_map(town, (f"road {town.road_id[lane]}", int(town.lane_id[lane]), 1.0))
        assert town.road_id[found] == town.road_id[lane]
        assert town.lane_id[found] == town.lane_id[lane]
        assert 0.0 <= s <= town.graph.length[found]
