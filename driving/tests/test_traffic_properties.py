"""Whatever the ego does, however many drive: traffic stays whole and is a function of its seed."""

import math

import numpy as np
import pytest
from athrl_driving.maps import Town, lane_pose, load_town
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.flow import overlapping_pairs
from athrl_driving.traffic.signals import GREEN, RED, light
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import Traffic, environment_views, new_traffic
from athrl_driving.traffic.tick import tick
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

NO_EGO = np.zeros(EGO_SIZE)
NOWHERE = np.full(1, -1)
RELAXED = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])


def placed(town: Town, vehicles: int, seed: int, environments: int = 1) -> Traffic:
    traffic = new_traffic(town, environments, vehicles)
    for e in range(environments):
        place_vehicles(traffic, e, np.random.default_rng(seed + e), None, 0.0, NO_EGO)
    return traffic


@RELAXED
@given(
    name=st.sampled_from(["town02", "town03", "town04"]),
    seed=st.integers(0, 2**32),
    vehicles=st.integers(0, 120),
    moves=st.lists(st.tuples(st.floats(-4.0, 4.0), st.floats(-0.5, 0.5)), min_size=1, max_size=12),
)
def test_no_behaviour_of_the_ego_makes_two_background_vehicles_collide(
    name: str, seed: int, vehicles: int, moves: list[tuple[float, float]]
) -> None:
    """The ego drives where it likes, over lines, against the traffic and backwards."""
    town = load_town(name)
    traffic = placed(town, vehicles, seed % 1000)
    background = environment_views(traffic, 0).background
    random = np.random.default_rng(seed)
    lane = int(random.integers(len(town.graph.length)))
    ego = np.zeros(EGO_SIZE)
    ego[:3] = lane_pose(town.graph, lane, random.uniform(0.0, town.graph.length[lane]))
    ego[4:6], ego[6], ego[7] = (4.9, 2.1), town.graph.elevation[lane], 1.0
    path = np.array([lane, -1]) if seed % 2 else NOWHERE
    for acceleration, turning in moves:
        for _ in range(40):
            tick(traffic, 0, ego, path, 0.1)
            ego[0] += 0.1 * ego[3] * math.cos(ego[2])
            ego[1] += 0.1 * ego[3] * math.sin(ego[2])
            ego[2] += 0.1 * turning
            ego[3] = min(max(ego[3] + 0.1 * acceleration, -4.0), 14.0)
            assert overlapping_pairs(background) == 0


@pytest.mark.parametrize("name", ["town02", "town04"])
def test_an_environment_does_not_depend_on_the_batch_around_it(name: str) -> None:
    town = load_town(name)
    batch, alone = placed(town, 60, 5, environments=3), placed(town, 60, 7)
    for _ in range(300):
        for e in (2, 0, 1):
            tick(batch, e, NO_EGO, NOWHERE, 0.1)
        tick(alone, 0, NO_EGO, NOWHERE, 0.1)
    for found, expected in zip(batch.background, alone.background, strict=True):
        assert np.array_equal(found[2], expected[0])


def test_lane_changes_are_smooth_and_stay_between_the_lanes() -> None:
    town = load_town("town04")
    traffic = placed(town, 200, 0)
    view = environment_views(traffic, 0)
    background, changes = view.background, view.lane_changes
    begun = 0
    for _ in range(900):
        x, y, heading = background.x.copy(), background.y.copy(), background.heading.copy()
        changing = changes.distance > 0.0
        speed = background.speed.copy()
        tick(traffic, 0, NO_EGO, NOWHERE, 0.1)
        begun += int((~changing & (changes.distance > 0.0)).sum())
        # No jump: sideways too, no vehicle moves further than it drives.
        assert (np.hypot(background.x - x, background.y - y) <= 0.1 * speed * 1.2 + 1e-3).all()
        turned = np.abs(np.remainder(background.heading - heading + np.pi, 2 * np.pi) - np.pi)
        assert turned.max() < 0.25
        assert np.abs(background.offset).max() < 4.5
    assert begun > 10


def test_an_ego_on_a_bridge_covers_only_links_of_its_own_level() -> None:
    town = load_town("town04")
    graph = town.graph
    middle = graph.elevation + 0.5 * graph.grade * graph.length
    high = int(np.argmax(middle))
    poses = np.array([lane_pose(graph, lane, 0.5 * graph.length[lane]) for lane in range(len(graph.length))])
    assert middle[high] > 3.0
    x, y, heading = poses[high]
    ego = np.array([x, y, heading, 0.0, 4.9, 2.1, middle[high], 1.0])
    traffic = placed(town, 1, 0)
    for elevation, covered in ((middle[high], True), (middle[high] - 5.0, False)):
        ego[6] = elevation
        tick(traffic, 0, ego, NOWHERE, 0.0)
        link = traffic.lane_links.link[high]
        assert np.isfinite(traffic.ego_on_links.rear[0, link]) == covered


def test_no_movement_is_granted_at_a_light_that_is_not_green() -> None:
    towns = [town for town in map(load_town, ("town02", "town03", "town04")) if len(town.signals.cycle)]
    if not towns:
        pytest.skip("no town of ours has signals")
    town = towns[-1]
    traffic = placed(town, 120, 3)
    view = environment_views(traffic, 0)
    granted = view.right_of_way.granted
    seen, new_grants = set(), 0
    for _ in range(1200):
        before = granted.copy()
        lights = {m: light.py_func(view, m) for m in np.flatnonzero(traffic.lane_links.signal >= 0).tolist()}
        tick(traffic, 0, NO_EGO, NOWHERE, 0.1)
        seen |= set(lights.values())
        for movement in granted[(granted != before) & (granted >= 0)].tolist():
            if movement in lights:
                new_grants += 1
                assert lights[movement] == GREEN
    assert {GREEN, RED} <= seen
    assert new_grants > 0
