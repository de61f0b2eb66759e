"""The case studies place the ego in the described situation, and can be driven."""

import math
import re

import numpy as np
import pytest
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv
from athrl_driving.maps import load_town
from athrl_driving.maps.lane_graph import TURN_LEFT
from athrl_driving.scenarios import SCENARIOS, places_near
from athrl_driving.traffic.state import new_traffic
from numpy.typing import NDArray

TOWN = load_town("town03")


def drive(env: TownEnv, seed: int) -> tuple[dict, list[NDArray[np.float64]]]:
    """Drive an episode with the rule-based driver; the last info, and the other vehicles.

    They are float64 [n, 4] at each decision: position ahead and to the right of the ego (m), heading minus
    the ego's (rad) and the vehicle's distance from the ego (m).
    """
    env.reset(seed=seed)
    driver, seen = RuleBasedDriver(), []
    driver.reset(env, seed)
    while True:
        _, _, terminated, truncated, info = env.step(driver.act(env))
        ego, others = env.vehicle, env.road.background
        dx, dy = others.x - ego.position[0], others.y - ego.position[1]
        cosine, sine = math.cos(ego.heading), math.sin(ego.heading)
        turn = (others.heading - ego.heading + math.pi) % (2.0 * math.pi) - math.pi
        seen.append(
            np.stack([dx * cosine + dy * sine, dy * cosine - dx * sine, turn, np.hypot(dx, dy)], axis=1)
        )
        if terminated or truncated:
            return info, seen


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_rule_based_driver_passes(name: str) -> None:
    env = TownEnv(config=SCENARIOS[name])
    for seed in range(20):
        info, _ = drive(env, seed)
        assert not info["collision"], f"seed {seed}"
        assert not info["off_lane"], f"seed {seed}"
        assert env.episodes.state.progress.arrived[0], f"seed {seed}"
        assert info["metrics"]["route_completion"] == info["metrics"]["success"] == 1.0, f"seed {seed}"


def test_an_unfinished_route_at_the_time_limit_is_no_success() -> None:
    on_the_way = TownEnv(config={**SCENARIOS["athrl/Roundabout-v0"], "episode_ticks": 50})
    info, _ = drive(on_the_way, 0)
    assert (info["metrics"]["crash"], info["metrics"]["success"]) == (0.0, 0.0)
    nowhere_to_arrive = TownEnv(config={"vehicles_count": 20, "episode_ticks": 50})
    info, _ = drive(nowhere_to_arrive, 0)
    assert info["metrics"]["success"] == 1.0


def test_ego_meets_oncoming_vehicles() -> None:
    env = TownEnv(config=SCENARIOS["athrl/OncomingTraffic-v0"])
    for seed in range(5):
        _, seen = drive(env, seed)
        met = [
            np.any((abs(v[:, 2]) > 3.0) & (v[:, 1] < -2.5) & (v[:, 1] > -4.5) & (v[:, 3] < 8.0)) for v in seen
        ]
        assert np.any(met), f"seed {seed}"


def test_ego_drives_in_the_ring_among_others() -> None:
    env = TownEnv(config=SCENARIOS["athrl/Roundabout-v0"])
    in_ring, shared = 0, 0
    for seed in range(5):
        env.reset(seed=seed)
        driver = RuleBasedDriver()
        ended = False
        while not ended:
            _, _, terminated, truncated, _ = env.step(driver.act(env))
            others = env.road.background
            if math.hypot(*env.vehicle.position) < 26.0:
                in_ring += 1
                shared += bool(np.any(np.hypot(others.x, others.y) < 26.0))
            ended = terminated or truncated
    assert in_ring > 5 * 10
    assert shared > 0.5 * in_ring


def test_ego_turns_left_across_traffic() -> None:
    env = TownEnv(config=SCENARIOS["athrl/UnprotectedLeft-v0"])
    env.reset(seed=0)
    graph, movements = TOWN.graph, TOWN.movements
    way = next(int(graph.movement[lane]) for lane in env.route.lanes if graph.movement[lane] >= 0)
    assert graph.turn[movements.lane[movements.lane_start[way]]] == TURN_LEFT
    against = movements.conflict[movements.conflict_start[way] : movements.conflict_start[way + 1]]
    origins = {TOWN.road_name[movements.origin[other]] for other in against}
    assert "Market Road" in origins
    oncoming = {lane for lane in range(len(TOWN.road_name)) if TOWN.road_name[lane] == "Market Road"}
    for seed in range(5):
        env.reset(seed=seed)
        there = sum(int(lane) in oncoming for lane in env.road.background.lane)
        assert there >= 2, f"seed {seed}"


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_same_seed_gives_the_same_scene_at_the_same_place(name: str) -> None:
    first, second = TownEnv(config=SCENARIOS[name]), TownEnv(config=SCENARIOS[name])
    first.reset(seed=1)
    second.reset(seed=0)
    place = second.vehicle.position.copy()
    second.reset(seed=1)
    np.testing.assert_array_equal(place, second.vehicle.position)
    for column in ("x", "y", "heading", "speed", "desired_speed"):
        one, other = (getattr(env.road.background, column) for env in (first, second))
        np.testing.assert_array_equal(one, other)
    x, y, radius = SCENARIOS[name]["traffic_near"]
    others = second.road.background
    assert np.all(np.hypot(others.x - x, others.y - y) <= radius + 1.0)
    before = others.x.copy()
    second.reset(seed=2)
    assert not np.array_equal(before, second.road.background.x)


@pytest.mark.parametrize("vehicles", [500, 5000])
def test_vehicles_that_do_not_fit_are_told_how_many_would_there(vehicles: int) -> None:
    env = TownEnv(config=SCENARIOS["athrl/UnprotectedLeft-v0"])
    with pytest.raises(ValueError, match="within 140 m") as error:
        env.reset(options={"config": {"vehicles_count": vehicles}})
    place = r"within 140 m of \(165, 0\) \(traffic_near\) there is room for"
    found = re.match(rf"vehicles_count is {vehicles}, but {place} (\d+)", str(error.value))
    assert found, error.value
    env.reset(options={"config": {"vehicles_count": int(found[1]) - 10}})


def test_place_without_lanes_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"vehicles cannot start within 5 m of \(9000, 0\): there is no lane"
    ):
        places_near(new_traffic(TOWN, 1, 1), 9000.0, 0.0, 5.0)
