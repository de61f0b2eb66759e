"""At junctions the ego is a vehicle like the others."""

import numpy as np
import pytest
from athrl_driving.maps import Town, lane_pose, load_town
from athrl_driving.traffic import TrafficRoad
from highway_env.vehicle.kinematics import Vehicle


@pytest.fixture(scope="module")
def town() -> Town:
    return load_town("town03")


def movement_lanes(town: Town, movement: int) -> np.ndarray:
    movements = town.movements
    return movements.lane[movements.lane_start[movement] : movements.lane_start[movement + 1]]


def conflicts(town: Town, movement: int) -> np.ndarray:
    movements = town.movements
    return movements.conflict[movements.conflict_start[movement] : movements.conflict_start[movement + 1]]


def road_with_ego(town: Town, lane: int, s: float, vehicles: int, seed: int) -> TrafficRoad:
    """Return a road with a standing ego at `s` metres along a lane."""
    road = TrafficRoad(town, vehicles, np_random=np.random.default_rng(seed))
    x, y, heading = lane_pose(town.graph, lane, s)
    road.vehicles.append(Vehicle(road, (x, y), heading, speed=0.0))
    road.spawn_background((x, y))
    return road


def busiest_movement(town: Town) -> int:
    return int(np.argmax(np.diff(town.movements.conflict_start)))


def test_an_ego_at_the_line_of_a_busy_junction_gets_its_turn(town: Town) -> None:
    for movement in (busiest_movement(town), int(np.flatnonzero(town.movements.yields)[0])):
        origin = int(town.movements.origin[movement])
        road = road_with_ego(town, origin, town.graph.length[origin] - 4.0, 150, seed=movement)
        road.ego_path = np.array([origin, *movement_lanes(town, movement), town.movements.exit[movement]])
        for tick in range(600):
            road.act()
            road.step(0.1)
            if tick > 0 and road.ego_may_enter():
                break
        assert road.ego_may_enter()
        assert road.ego_stop_line() == pytest.approx(1.5, abs=0.01)


def test_while_the_ego_holds_its_movement_no_conflicting_one_is_granted(town: Town) -> None:
    movement = busiest_movement(town)
    origin = int(town.movements.origin[movement])
    crossing = set(conflicts(town, movement))
    road = road_with_ego(town, origin, town.graph.length[origin] - 4.0, 150, seed=0)
    road.ego_path = np.array([origin, *movement_lanes(town, movement), town.movements.exit[movement]])
    right_of_way = road.traffic.right_of_way
    held = 0
    for _ in range(600):
        before = set(right_of_way.granted[:-1])
        road.act()
        road.step(0.1)
        if right_of_way.granted[-1] == movement:
            held += 1
            fresh = set(right_of_way.granted[:-1]) - before
            assert not fresh & crossing
    assert held > 0


def test_an_ego_that_does_not_go_does_not_keep_the_others_from_crossing(town: Town) -> None:
    movement = busiest_movement(town)
    origin = int(town.movements.origin[movement])
    road = road_with_ego(town, origin, town.graph.length[origin] - 4.0, 150, seed=0)
    road.ego_path = np.array([origin, *movement_lanes(town, movement), town.movements.exit[movement]])
    right_of_way = road.traffic.right_of_way
    ego_held, others_crossed_after = False, set()
    for _ in range(1200):
        road.act()
        road.step(0.1)
        ego_held |= right_of_way.granted[-1] == movement
        if ego_held:
            others_crossed_after |= set(
                np.flatnonzero(np.isin(right_of_way.crossing[:-1], conflicts(town, movement)))
            )
    assert ego_held
    assert len(others_crossed_after) >= 3


@pytest.mark.parametrize("requests", [True, False])
def test_an_ego_in_a_junction_without_right_of_way_blocks_what_crosses_it(town: Town, requests: bool) -> None:
    movement = busiest_movement(town)
    lanes = movement_lanes(town, movement)
    middle = int(lanes[len(lanes) // 2])
    road = road_with_ego(town, middle, 0.5 * town.graph.length[middle], 150, seed=1)
    if requests:
        road.ego_path = np.array([*lanes, town.movements.exit[movement]])
    right_of_way = road.traffic.right_of_way
    for _ in range(600):
        road.act()
        road.step(0.1)
        assert not set(right_of_way.granted[:-1]) & set(conflicts(town, movement))
        assert not road.vehicles[0].crashed


def test_no_vehicle_enters_a_junction_without_holding_its_movement(town: Town) -> None:
    road = TrafficRoad(town, 150, np_random=np.random.default_rng(4))
    road.spawn_background()
    background, right_of_way, graph = road.background, road.traffic.right_of_way, town.graph
    entered = 0
    for _ in range(1000):
        lanes, held = background.lane.copy(), right_of_way.granted[:-1].copy()
        requested = right_of_way.ahead[:-1].copy()
        road.step(0.1)
        fresh = (graph.movement[lanes] < 0) & (graph.movement[background.lane] >= 0)
        entered += fresh.sum()
        assert (held[fresh] == graph.movement[background.lane[fresh]]).all()
        assert (requested[fresh] == held[fresh]).all()
    assert entered > 100


def test_the_leader_of_the_ego_is_found_along_its_path(town: Town) -> None:
    lane = int(np.flatnonzero((town.graph.length > 100.0) & (town.graph.curvature == 0.0))[0])
    road = road_with_ego(town, lane, 20.0, 1, seed=0)
    following = town.graph.successor[town.graph.successor_start[lane]]
    road.ego_path = np.array([lane, following])
    background = road.background
    background.lane[0], background.s[0], background.speed[0] = lane, 50.0, 3.0
    gap, speed = road.leader_of_ego()
    assert gap == pytest.approx(30.0 - 0.5 * (Vehicle.LENGTH + background.length[0]))
    assert speed == 3.0
    background.lane[0], background.s[0] = following, 1.0
    gap, _ = road.leader_of_ego()
    expected = town.graph.length[lane] - 20.0 + 1.0 - 5.0
    assert gap == (pytest.approx(expected) if expected < 50.0 else np.inf)
