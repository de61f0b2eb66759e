"""Traffic takes account of the ego: followers stop behind it, and its leader is found during lane changes."""

import math

import numpy as np
import pytest
from athrl_driving.envs import TownEnv
from athrl_driving.maps import Town, lane_pose, load_town
from athrl_driving.traffic import TrafficRoad
from athrl_driving.traffic.collision import first_touched
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import Traffic, environment_views, new_traffic
from athrl_driving.traffic.tick import tick
from highway_env.vehicle.kinematics import Vehicle

DT = 0.1
NONE = -1
EGO_LENGTH = 4.9


@pytest.fixture(scope="module")
def town() -> Town:
    return load_town("town04")


def longest_lane_with_one_beside(town: Town) -> tuple[int, int]:
    graph = town.graph
    fits = (graph.curvature == 0.0) & (graph.junction < 0) & (graph.left >= 0)
    lane = int(np.argmax(np.where(fits, graph.length, 0.0)))
    return lane, int(graph.left[lane])


def put_vehicle(view: Traffic, lane: int, s: float, speed: float) -> None:
    """Put vehicle 0 on a lane, where it is to stay."""
    background = view.background
    background.lane[0], background.s[0], background.speed[0] = lane, s, speed
    background.x[0], background.y[0], background.heading[0] = lane_pose(view.graph, lane, s)
    background.path[0] = NONE
    background.path[0, 0] = view.lane_links.link[lane]
    view.lane_changes.next_decision[0] = np.inf


@pytest.mark.parametrize("braking", [2.0, 4.0, 6.0])
@pytest.mark.parametrize("gap", [6.0, 12.0, 25.0])
def test_a_follower_of_a_braking_ego_stops_behind_it_and_continues_with_it(
    town: Town, braking: float, gap: float
) -> None:
    lane, _ = longest_lane_with_one_beside(town)
    traffic = new_traffic(town, 1, 1)
    place_vehicles(traffic, 0, np.random.default_rng(0), None, 0.0, np.zeros(EGO_SIZE))
    view = environment_views(traffic, 0)
    put_vehicle(view, lane, 20.0, 7.0)
    follower = view.background
    follower.desired_speed[0] = 9.0
    lengths = 0.5 * (EGO_LENGTH + follower.length[0])
    s, speed, gaps = 20.0 + gap + lengths, 7.0, []
    ego = np.array([0.0, 0.0, 0.0, 0.0, EGO_LENGTH, 2.1, town.graph.elevation[lane], 1.0])
    for acceleration, ticks in ((0.0, 20), (-braking, 150), (1.0, 150)):
        for _ in range(ticks):
            ego[:3], ego[3] = lane_pose(town.graph, lane, s), speed
            tick(traffic, 0, ego, np.array([lane]), DT)
            s, speed = s + speed * DT, min(max(speed + acceleration * DT, 0.0), 5.0)
            assert first_touched(follower, ego) == NONE
        gaps.append(s - follower.s[0] - lengths)
        if acceleration < 0.0:
            assert speed == 0.0
            assert follower.speed[0] < 0.01
    assert 0.5 < gaps[1] < 6.0
    assert follower.speed[0] == pytest.approx(5.0, abs=0.5)
    # Where the model neither accelerates nor brakes: 10 m and 1.5 s, less 5 m of length, at 5 of 9 m/s.
    assert gaps[2] == pytest.approx((10.0 + 1.5 * 5.0) / math.sqrt(1.0 - (5.0 / 9.0) ** 4) - 5.0, abs=0.2)


def test_a_vehicle_waits_behind_an_ego_that_stands_between_two_lanes(town: Town) -> None:
    for came_from in (0, 1):
        lanes = longest_lane_with_one_beside(town)
        lane = lanes[came_from]
        traffic = new_traffic(town, 1, 1)
        place_vehicles(traffic, 0, np.random.default_rng(0), None, 0.0, np.zeros(EGO_SIZE))
        view = environment_views(traffic, 0)
        put_vehicle(view, lane, 20.0, 7.0)
        one, other = (np.array(lane_pose(town.graph, each, 80.0)) for each in lanes)
        ego = np.array([*0.5 * (one + other), 0.0, EGO_LENGTH, 2.1, town.graph.elevation[lane], 1.0])
        for _ in range(300):
            tick(traffic, 0, ego, np.array(lanes), DT)
            assert first_touched(view.background, ego) == NONE
        assert view.background.speed[0] < 0.01
        assert 70.0 < view.background.s[0] + 0.5 * (EGO_LENGTH + view.background.length[0]) < 80.0


def road_with_changing_ego(town: Town, path: list[int]) -> tuple[TrafficRoad, int, int]:
    """Return a road with one vehicle and an ego 20 m along a lane that is to change to the one beside."""
    lane, beside = longest_lane_with_one_beside(town)
    road = TrafficRoad(town, 1, np_random=np.random.default_rng(0))
    x, y, heading = lane_pose(town.graph, lane, 20.0)
    ego = Vehicle(road, (x, y), heading, speed=5.0)
    ego.elevation = float(town.graph.elevation[lane])
    road.vehicles.append(ego)
    road.spawn_background((x, y))
    road.ego_path = np.array([lane, beside, *path])
    return road, lane, beside


def test_the_egos_leader_is_found_on_the_lane_that_it_changes_to(town: Town) -> None:
    road, origin, beside = road_with_changing_ego(town, [])
    lengths = 0.5 * (Vehicle.LENGTH + road.background.length[0])
    for lane in (origin, beside):
        put_vehicle(road.traffic, lane, 50.0, 3.0)
        gap, speed = road.leader_of_ego()
        assert (gap, speed) == (pytest.approx(30.0 - lengths, abs=0.1), 3.0)
    # A vehicle on a lane that is not on its path does not count.
    (apart,) = {int(town.graph.left[beside]), int(town.graph.right[origin])} - {-1}
    put_vehicle(road.traffic, apart, 50.0, 3.0)
    assert road.leader_of_ego() == (np.inf, 0.0)


def test_a_lane_change_does_not_lengthen_the_egos_path_to_a_junction(town: Town) -> None:
    graph, movements = town.graph, town.movements
    for movement in range(movements.origin.size):
        origin = int(movements.origin[movement])
        if graph.left[origin] >= 0 and graph.length[origin] > 30.0:
            break
    else:
        pytest.fail("no lane with one on its left leads to a junction")
    first = int(movements.lane[movements.lane_start[movement]])
    s = float(graph.length[origin]) - 15.0
    road = TrafficRoad(town, 0, np_random=np.random.default_rng(0))
    for lane in (origin, int(graph.left[origin])):
        x, y, heading = lane_pose(graph, lane, s * graph.length[lane] / graph.length[origin])
        ego = Vehicle(road, (x, y), heading, speed=5.0)
        ego.elevation = float(graph.elevation[lane])
        road.vehicles = [ego]
        road.ego_path = np.array([lane, origin, first] if lane != origin else [origin, first])
        road.leader_of_ego()
        assert road.ego_stop_line() == pytest.approx(15.0 - 0.5 * Vehicle.LENGTH, abs=0.2)


def test_asking_for_the_leader_does_not_change_the_traffic() -> None:
    curious, other = (TownEnv(config={"town": "town04"}) for _ in range(2))
    action = np.array([0.5, 0.0], np.float32)
    for env in (curious, other):
        env.reset(seed=3)
    for _ in range(60):
        curious.road.leader_of_ego()
        results = [env.step(action) for env in (curious, other)]
        for name in ("lane", "s", "speed", "x", "y"):
            one, two = (getattr(env.road.background, name) for env in (curious, other))
            np.testing.assert_array_equal(one, two, err_msg=name)
        if results[0][2] or results[0][3]:
            break
