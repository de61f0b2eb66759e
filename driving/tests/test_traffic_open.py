"""Traffic on open maps: as many enter as leave, nobody meets another one at the edge or drives past it."""

import math
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps import Town, lane_pose
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.flow import overlapping_pairs
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import Traffic, environment_views, new_traffic, starting_places
from athrl_driving.traffic.tick import tick
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from driving.tests.small_map import SmallMap

NO_EGO = np.zeros(EGO_SIZE)
NOWHERE = np.full(1, -1)
RELAXED = settings(
    deadline=None,
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


def placed(town: Town, vehicles: int, seed: int, environments: int = 1) -> Traffic:
    traffic = new_traffic(town, environments, vehicles)
    for e in range(environments):
        place_vehicles(traffic, e, np.random.default_rng(seed + e), None, 0.0, NO_EGO)
    return traffic


def drive_and_check(traffic: Traffic, ticks: int, ego: np.ndarray = NO_EGO) -> int:
    """Let all drive; at every tick all are on lanes and touch nobody. Return how often one entered."""
    view = environment_views(traffic, 0)
    background, graph, links = view.background, view.graph, view.lane_links
    entered = 0
    for _ in range(ticks):
        before = background.x.copy(), background.y.copy()
        tick(traffic, 0, ego, NOWHERE, 0.1)
        assert np.isfinite([background.x, background.y, background.heading, background.speed]).all()
        assert ((background.speed >= 0.0) & (background.speed < 15.0)).all()
        assert ((background.lane >= 0) & (background.lane < graph.length.size)).all()
        assert ((background.s >= 0.0) & (background.s <= graph.length[background.lane])).all()
        assert overlapping_pairs(background) == 0
        jumped = np.hypot(background.x - before[0], background.y - before[1]) > 2.0
        assert np.isin(links.link[background.lane[jumped]], links.entries).all()
        entered += int(jumped.sum())
    return entered


@pytest.mark.parametrize("share", [0.05, 0.4, 1.0])
def test_as_many_enter_as_leave_and_nobody_touches_another(tmp_path: Path, share: float) -> None:
    small_map = SmallMap()
    small_map.crossing([100.0, 60.0, 80.0, 120.0])
    town = small_map.load(tmp_path)
    vehicles = max(1, int(share * starting_places(town)))
    traffic = placed(town, vehicles, 3)
    assert drive_and_check(traffic, 900) > vehicles / 2
    # Also where every place was taken somebody still drives at the end.
    assert environment_views(traffic, 0).background.speed.max() > 0.5


def test_vehicles_enter_on_every_road_that_enters_the_map(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.crossing([60.0, 60.0, 60.0, 60.0])
    small_map.road(50, (500, 0, 0), [(200, 0)], lanes=(-1, -2))
    town = small_map.load(tmp_path)
    traffic = placed(town, 12, 0)
    links, background = traffic.lane_links, environment_views(traffic, 0).background
    used = set()
    for _ in range(1500):
        before = background.x.copy(), background.y.copy()
        tick(traffic, 0, NO_EGO, NOWHERE, 0.1)
        jumped = np.hypot(background.x - before[0], background.y - before[1]) > 2.0
        used |= set(links.link[background.lane[jumped]].tolist())
    assert used == set(links.entries.tolist())
    assert len(used) == 6


def test_nobody_waits_for_ever_at_the_edge_while_others_enter(tmp_path: Path) -> None:
    """A road enters with one lane and leaves with four, which bring more vehicles than can enter."""
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(150, 0)], lanes=(-1,), after=(2, "start"))
    small_map.road(2, (150, 0, 0), [(150, 0)], lanes=(-1, -2, -3, -4), before=(1, "end"))
    traffic = placed(small_map.load(tmp_path), 30, 0)
    background = environment_views(traffic, 0).background
    stood = longest = np.zeros(30)
    for _ in range(300):
        drive_and_check(traffic, 10)
        stood = np.where(background.speed < 0.1, stood + 1.0, 0.0)
        longest = np.maximum(longest, stood)
    assert longest.max() < 60.0


@pytest.mark.parametrize("lanes", [3, 4])
def test_lanes_that_end_side_by_side_never_block_each_other(tmp_path: Path, lanes: int) -> None:
    """Their vehicles change from one ending lane to the next, each where that leaves room for its change."""
    small_map = SmallMap()
    ids = [-1 - lane for lane in range(lanes)]
    small_map.road(1, (0, 0, 0), [(150, 0)], lanes=ids, after=(2, "start"))
    small_map.road(2, (150, 0, 0), [(150, 0)], lanes=(-1,), before=(1, "end"))
    traffic = placed(small_map.load(tmp_path), 18, 0)
    drive_and_check(traffic, 600)
    assert drive_and_check(traffic, 600) > 9


def test_a_free_road_is_as_fast_over_the_edge_as_before_it(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(300, 0)], lanes=(-1,))
    traffic = placed(small_map.load(tmp_path), 1, 0)
    background = environment_views(traffic, 0).background
    drive_and_check(traffic, 100)
    slowest = math.inf
    for _ in range(900):
        tick(traffic, 0, NO_EGO, NOWHERE, 0.1)
        slowest = min(slowest, float(background.speed[0]))
    assert slowest > 0.9 * background.desired_speed[0]


def test_traffic_covers_the_parts_of_a_map_by_their_length(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.ring(1, 0.0)
    small_map.road(5, (0, -300, 0), [(800, 0)], lanes=(-1,))
    town = small_map.load(tmp_path)
    on_road = np.array([name == "road 5" for name in town.road_name])
    share = town.graph.length[on_road].sum() / town.graph.length.sum()
    for seed in range(3):
        traffic = placed(town, 60, seed)
        background = environment_views(traffic, 0).background
        before = int(on_road[background.lane].sum())
        assert before / 60 == pytest.approx(share, abs=0.15)
        drive_and_check(traffic, 300)
        # No vehicle leaves its part: it enters again where roads enter.
        assert int(on_road[background.lane].sum()) == before


def test_parts_that_cross_give_way_to_each_other(tmp_path: Path) -> None:
    """A ring road and a road across the map meet at a crossing on which nobody turns."""
    small_map = SmallMap()
    small_map.crossing([60.0] * 4, turns=False, after={0: (7, "start"), 2: (7, "end")})
    bend = (40.0 * math.pi, 1.0 / 40.0)
    small_map.road(7, (72, 0, 0), [bend, (144, 0), bend], before=(0, "end"), after=(2, "end"))
    town = small_map.load(tmp_path)
    assert town.left_out == ()
    assert {town.road_name[lane] for lane in np.flatnonzero(town.graph.leaves)} == {"road 1", "road 3"}
    traffic = placed(town, 30, 1)
    view, names = environment_views(traffic, 0), np.array(town.road_name)
    ring = np.isin(names, ["road 0", "road 2", "road 7", "road 102", "road 120"])
    before, crossed = ring[view.background.lane].copy(), set()
    for _ in range(1200):
        tick(traffic, 0, NO_EGO, NOWHERE, 0.1)
        assert overlapping_pairs(view.background) == 0
        assert np.array_equal(ring[view.background.lane], before)
        crossed |= set(view.right_of_way.crossing[:-1].tolist())
    assert crossed - {-1} == set(range(4))


def test_a_vehicle_waits_at_the_edge_until_there_is_a_free_entry(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(100, 0)], lanes=(-1,))
    town = small_map.load(tmp_path)
    traffic = placed(town, 3, 0)
    background = environment_views(traffic, 0).background
    # The ego stands where the only road enters the map.
    ego = np.array([*lane_pose(town.graph, 0, 3.0), 0.0, 4.9, 2.1, 0.0, 1.0])
    background.lane[:], background.s[:], background.speed[:] = 0, [20.0, 40.0, 60.0], 0.0
    drive_and_check(traffic, 600, ego)
    front = background.s.max() + 0.5 * background.length[0]
    assert 98.0 < front < 100.0
    assert (background.speed < 0.1).all()
    assert drive_and_check(traffic, 300) > 3


@pytest.mark.parametrize("seed", range(2))
def test_the_same_seed_drives_the_same_in_any_batch(tmp_path: Path, seed: int) -> None:
    small_map = SmallMap()
    small_map.crossing([60.0, 90.0, 60.0, 0.0])
    town = small_map.load(tmp_path)
    batch, alone = placed(town, 15, seed, environments=3), placed(town, 15, seed + 2)
    for _ in range(600):
        for e in (2, 0, 1):
            tick(batch, e, NO_EGO, NOWHERE, 0.1)
        tick(alone, 0, NO_EGO, NOWHERE, 0.1)
    for found, expected in zip(batch.background, alone.background, strict=True):
        assert np.array_equal(found[2], expected[0])


@RELAXED
@given(
    seed=st.integers(0, 2**32),
    vehicles=st.integers(0, 30),
    moves=st.lists(st.tuples(st.floats(-4.0, 4.0), st.floats(-0.5, 0.5)), min_size=1, max_size=12),
)
def test_no_behaviour_of_the_ego_at_the_edge_makes_two_vehicles_collide(
    tmp_path: Path, seed: int, vehicles: int, moves: list[tuple[float, float]]
) -> None:
    """The ego begins at an entry or an exit, and drives where it likes, also off the map."""
    small_map = SmallMap()
    small_map.crossing([70.0, 60.0, 50.0, 60.0])
    town = small_map.load(tmp_path)
    traffic, random = placed(town, vehicles, seed % 1000), np.random.default_rng(seed)
    lane = int(random.choice(np.flatnonzero(town.graph.enters | town.graph.leaves)))
    s = random.uniform(0.0, 20.0)
    s = town.graph.length[lane] - s if town.graph.leaves[lane] else s
    ego = np.array([*lane_pose(town.graph, lane, s), 0.0, 4.9, 2.1, 0.0, 1.0])
    for acceleration, turning in moves:
        for _ in range(40):
            drive_and_check(traffic, 1, ego)
            ego[0] += 0.1 * ego[3] * math.cos(ego[2])
            ego[1] += 0.1 * ego[3] * math.sin(ego[2])
            ego[2] += 0.1 * turning
            ego[3] = min(max(ego[3] + 0.1 * acceleration, -4.0), 14.0)


@RELAXED
@given(
    arms=st.lists(st.floats(13.0, 150.0), min_size=4, max_size=4),
    absent=st.integers(-1, 3),
    pieces=st.lists(st.tuples(st.floats(2.0, 80.0), st.floats(-0.6, 0.6)), min_size=1, max_size=5),
    lanes=st.sampled_from([(-1,), (1, -1), (-1, -2, -3), (2, 1, -1, -2)]),
    share=st.floats(0.0, 1.0),
    seed=st.integers(0, 2**32),
)
def test_small_open_networks_drive(
    tmp_path: Path,
    arms: list[float],
    absent: int,
    pieces: list[tuple[float, float]],
    lanes: tuple[int, ...],
    share: float,
    seed: int,
) -> None:
    """Arms of a crossing, and pieces of a road that turn by so many rad each: too little to cross itself."""
    small_map = SmallMap()
    small_map.crossing([0.0 if arm == absent else length for arm, length in enumerate(arms)])
    end, last = (1000.0, 0.0, 0.0), len(pieces) - 1
    for number, (length, turn) in enumerate(pieces):
        end = small_map.road(
            10 + number,
            end,
            [(length, max(min(turn / length, 0.05), -0.05))],
            lanes,
            (9 + number, "end") if number else None,
            (11 + number, "start") if number < last else None,
        )
    town = small_map.load(tmp_path)
    assert town.graph.leaves.any()
    traffic = placed(town, int(share * starting_places(town)), seed % 1000)
    drive_and_check(traffic, 300)
