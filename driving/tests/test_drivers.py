"""Each driver does what it is meant to do, through the same actions as a policy."""

import gymnasium
import numpy as np
import pytest
from athrl_driving import make_driver
from athrl_driving.drivers import BlindRouteFollower, Driver, RandomDriver, RuleBasedDriver
from athrl_driving.envs import TownEnv
from athrl_driving.maps import lane_pose, lane_project
from athrl_driving.route import start_routes


def episode(env: TownEnv, driver: Driver, seed: int) -> tuple[float, dict]:
    """Return and last info of an episode."""
    env.reset(seed=seed)
    driver.reset(env, seed)
    total = 0.0
    while True:
        action = driver.act(env)
        assert env.action_space.contains(action)
        _, reward, terminated, truncated, info = env.step(action)
        total += reward
        if terminated or truncated:
            return total, info


def test_names_make_the_drivers() -> None:
    assert isinstance(make_driver("random"), RandomDriver)
    assert isinstance(make_driver("blind"), BlindRouteFollower)
    assert isinstance(make_driver("rule-based"), RuleBasedDriver)
    with pytest.raises(ValueError, match="no driver 'expert', there are random, blind, rule-based"):
        make_driver("expert")


def test_a_driver_says_what_it_needs() -> None:
    with pytest.raises(TypeError, match="needs a TownEnv, this is a CartPoleEnv"):
        make_driver("blind").reset(gymnasium.make("CartPole-v1"), 0)


def test_random_driver_repeats_itself_with_a_seed() -> None:
    env, driver = TownEnv(config={"vehicles_count": 0}), RandomDriver()
    draws = []
    for seed in (1, 1, 2):
        driver.reset(env, seed)
        draws.append(np.array([driver.act(env) for _ in range(20)]))
    np.testing.assert_array_equal(draws[0], draws[1])
    assert not np.array_equal(draws[0], draws[2])


def test_blind_follower_keeps_to_the_route_at_four_metres_a_second() -> None:
    env = TownEnv(config={"vehicles_count": 0})
    for seed in range(10):
        total, info = episode(env, BlindRouteFollower(), seed)
        assert not info["off_lane"]
        assert info["speed"] == pytest.approx(4.0, abs=0.1)
        assert 180 < info["distance"] < 200
        assert 1500 < total < 2000


@pytest.mark.parametrize("town", ["town02", "town03", "town04"])
def test_rule_based_driver_gets_through_traffic(town: str) -> None:
    env = TownEnv(config={"town": town})
    distances = []
    for seed in range(100, 110):
        _, info = episode(env, RuleBasedDriver(), seed)
        assert not info["collision"], f"seed {seed}"
        assert not info["off_lane"], f"seed {seed}"
        assert info["metrics"]["red_lights"] == 0
        distances.append(info["distance"])
    assert np.mean(distances) > (100 if town == "town02" else 230)


def change_ahead(env: TownEnv, seed: int) -> tuple[int, int, float]:
    """Reset and plan an immediate change to the right; the lane, the adjacent one, the ego's m along it."""
    graph = env.town.graph
    lane = int(np.flatnonzero((graph.right >= 0) & (graph.length > 90.0) & (graph.curvature == 0.0))[0])
    beside = int(graph.right[lane])
    env.reset(seed=seed)
    state, start = env.episodes.state, 15.0
    plan = np.array([lane, beside])
    start_routes(graph, state.routes, 0, lane, start, np.uint64(seed), plan, float(graph.length[lane]) - 1.0)
    x, y, heading = lane_pose(graph, lane, start)
    state.progress.ego[0, :4] = x, y, heading, 0.0
    state.progress.path[0] = -1
    ahead = env.route.lanes_ahead
    state.progress.path[0, : ahead.size] = ahead
    return lane, beside, start


def put_vehicle(env: TownEnv, lane: int, s: float) -> None:
    """Place vehicle 0, broken down, on a lane."""
    car, graph = env.road.background, env.town.graph
    car.x[0], car.y[0], car.heading[0] = lane_pose(graph, lane, s)
    car.lane[0], car.s[0], car.speed[0], car.crashed[0] = lane, s, 0.0, True
    car.path[0, 0] = env.road.traffic.lane_links.link[lane]


def test_rule_based_driver_does_not_change_into_an_occupied_lane() -> None:
    env = TownEnv(config={"town": "town03", "vehicles_count": 1, "episode_ticks": 10_000})
    _, beside, start = change_ahead(env, 3)
    put_vehicle(env, beside, start + 6.0)
    driver = RuleBasedDriver()
    for _ in range(60):
        _, _, terminated, _, _ = env.step(driver.act(env))
        assert not terminated
    # It has stopped before its lane change, beside the vehicle.
    assert env.vehicle.speed < 0.1
    assert env.route.position < 6.0
    graph, (x, y) = env.town.graph, env.vehicle.position
    put_vehicle(env, int(np.argmax(np.hypot(graph.start_x - x, graph.start_y - y))), 0.0)
    while env.route.position < 40.0:
        _, _, terminated, _, _ = env.step(driver.act(env))
        assert not terminated


def test_rule_based_driver_changes_lanes_where_its_route_does() -> None:
    env = TownEnv(config={"town": "town03", "vehicles_count": 0})
    _, beside, _ = change_ahead(env, 3)
    driver = RuleBasedDriver()
    while env.route.position < 50.0:
        _, _, terminated, _, _ = env.step(driver.act(env))
        assert not terminated
    ego = env.vehicle
    _, lateral = lane_project(env.town.graph, beside, *(float(value) for value in ego.position))
    assert abs(lateral) < 0.6


def test_rule_based_driver_stops_behind_a_standing_vehicle() -> None:
    env = TownEnv(config={"vehicles_count": 1})
    lane = int(np.argmax(np.where(env.town.graph.curvature == 0, env.town.graph.length, 0.0)))
    for seed in range(2000):
        env.reset(seed=seed)
        if env.route.lane == lane and env.town.graph.length[lane] + env.route.starts[env.route.index] > 80:
            break
    else:
        pytest.fail("no seed puts the ego on the longest straight lane")
    x, y, heading = env.route.poses(np.array([50.0]))[0]
    car = env.road.background
    car.x[0], car.y[0], car.heading[0], car.lane[0] = x, y, heading, lane
    car.s[0], car.speed[0], car.crashed[0] = 50.0 - env.route.starts[0], 0.0, True
    car.path[0, 0] = lane
    driver = RuleBasedDriver()
    for _ in range(60):
        _, _, terminated, _, info = env.step(driver.act(env))
        assert not terminated
    assert info["speed"] < 0.1
    assert 35.0 < env.route.position < 46.0
