"""The report on a map says what makes it hard to drive on, and its numbers fit each other."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.control import MAXIMUM_STEERING, WHEEL_ANGLE_PER_STEERING
from athrl_driving.episode.ego import CONTROL_SIZE, EGO_WHEELBASE, WHEEL_ANGLE, move_ego, place_ego
from athrl_driving.episode.starts import place_on_map
from athrl_driving.inspection import facts_of
from athrl_driving.inspection.bends import ego_radius
from athrl_driving.inspection.lines import lines_of
from athrl_driving.maps import Town, load_town
from athrl_driving.maps.crossings import FOUND as CROSSING
from athrl_driving.maps.lying_over import FOUND as LYING_OVER
from athrl_driving.traffic.ego_columns import SPEED, X, Y
from athrl_spaces import Limits

from driving.tests.small_map import SmallMap

SIDE = 60.0


def square(folder: Path, radius: float) -> Town:
    """A ring of two lanes with four bends of a radius in its middle, and a straight before each."""
    small_map = SmallMap()
    shapes = [(SIDE, 0.0), (0.5 * math.pi * radius, 1.0 / radius)] * 4
    small_map.road(1, (0.0, 0.0, 0.0), shapes, before=(1, "end"), after=(1, "start"))
    return small_map.load(folder)


def ring() -> SmallMap:
    """A ring of two straights and two half circles, on which vehicles drive without end."""
    small_map = SmallMap()
    shapes = [(200.0, 0.0), (80.0 * math.pi, 1.0 / 80.0)] * 2
    small_map.road(1, (0.0, 0.0, 0.0), shapes, before=(1, "end"), after=(1, "start"))
    return small_map


def warnings(town: Town) -> list[str]:
    return [line for name, line in lines_of(facts_of(town)) if name == "warning"]


def report(town: Town) -> dict[str, str]:
    return dict(lines_of(facts_of(town)))


def test_tightest_bend_is_told_with_its_place(tmp_path: Path) -> None:
    town = square(tmp_path, 6.0)
    bend = facts_of(town).bends.tightest
    assert bend is not None
    assert bend.radius == pytest.approx(6.0 - 1.75, abs=0.01)
    assert (bend.road, bend.lane) == ("road 1", 1)
    lane, s = place_on_map(town, (bend.road, bend.lane, bend.metres + 0.01))
    assert s == pytest.approx(0.01, abs=1e-6)
    assert 1.0 / abs(town.graph.curvature[lane]) == pytest.approx(bend.radius)
    assert (
        report(town)["tightest bend"]
        == f"radius of {bend.radius:.1f} m, road 1 lane 1 at {bend.metres:.0f} m"
    )


@pytest.mark.parametrize(("radius", "too_tight"), [(5.0, 2), (8.0, 1), (9.5, 0)])
def test_bends_that_the_ego_cannot_follow_are_warned_of(
    tmp_path: Path, radius: float, too_tight: int
) -> None:
    town = square(tmp_path, radius)
    assert facts_of(town).bends.too_tight == too_tight
    told = [line for line in warnings(town) if "tighter than the ego can steer" in line]
    assert len(told) == (1 if too_tight else 0)
    assert all("a radius of 7.6 m" in line for line in told)


def test_ego_at_full_lock_drives_the_circle_that_is_told() -> None:
    ego, control = np.zeros(16), np.zeros(CONTROL_SIZE)
    place_ego(ego, control, 0.0, 0.0, 0.0, 0.0)
    control[WHEEL_ANGLE] = MAXIMUM_STEERING * WHEEL_ANGLE_PER_STEERING
    ego[SPEED] = 2.0
    places = []
    for _ in range(4000):
        move_ego(ego, control, False, EGO_WHEELBASE, 0.01)
        places.append((ego[X], ego[Y]))
    extent = np.ptp(np.array(places), axis=0)
    assert 0.5 * extent == pytest.approx([ego_radius()] * 2, rel=0.01)


def test_ego_that_sees_waypoints_only_ahead_turns_less_tightly() -> None:
    assert ego_radius(Limits(waypoint_half_angle=math.radians(10.0))) > 2.0 * ego_radius()


def test_map_on_which_episodes_end_early_is_warned_of(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0.0, 0.0, 0.0), [(300.0, 0.0)])
    town = small_map.load(tmp_path)
    # Starts keep a car's length from the road's start, and 70 m from the edge.
    assert facts_of(town).driven.mean_way == pytest.approx(300.0 - 0.5 * (4.9 + 230.0), abs=1.0)
    (told,) = warnings(town)
    assert told.startswith("episodes end early: from a random start the map ends after 183 m in the mean")


def test_map_without_an_edge_has_a_way_for_whole_episodes() -> None:
    for name in ("town02", "town03", "town04"):
        town = load_town(name)
        assert facts_of(town).driven.mean_way == pytest.approx(400.0)
        assert warnings(town) == []


def test_kilometres_driven_and_left_out_are_those_of_all_lanes() -> None:
    for name in ("town02", "town03", "town04"):
        facts = facts_of(load_town(name))
        assert facts.lane_kilometres == facts.driven.kilometres
        assert facts.driven.share == 1.0


def test_extent_ends_with_the_lanes(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0.0, 0.0, 0.0), [(300.0, 0.0)])
    assert facts_of(small_map.load(tmp_path)).extent == pytest.approx((300.0, 7.0))


def test_lanes_of_no_length_are_not_listed() -> None:
    facts = facts_of(load_town("town02"))
    left_out = (("Long Road", 1, 12.0), ("Road 84", 6, 0.001))
    told = dict(lines_of(replace(facts, left_out=left_out)))["left out"]
    assert told.endswith(": Long Road lane 1 (12 m) and 1 more")
    assert dict(lines_of(replace(facts, left_out=left_out[1:])))["left out"].endswith(": 1 piece at joints")


def test_a_crossing_with_a_road_that_is_left_out_is_no_fault(tmp_path: Path) -> None:
    """A road from nowhere crosses a ring, on which vehicles drive on without end."""
    small_map = ring()
    small_map.road(2, (100.0, -10.0, 0.5 * math.pi), [(24.0, 0.0)], (-1,))
    town = small_map.load(tmp_path)
    assert {road for road, *_ in town.left_out} == {"road 2"}
    assert not [finding for finding in town.findings if finding.kind == CROSSING]


def test_a_road_that_lies_on_one_that_is_left_out_is_no_fault(tmp_path: Path) -> None:
    small_map = ring()
    small_map.road(2, (20.0, 0.0, 0.0), [(30.0, 0.0)], (-1,))
    town = small_map.load(tmp_path)
    assert {road for road, *_ in town.left_out} == {"road 2"}
    assert not [finding for finding in town.findings if finding.kind == LYING_OVER]


def test_metres_of_roads_have_no_millimetres(tmp_path: Path) -> None:
    small_map = SmallMap()
    for number in (1, 2):
        small_map.road(number, (0.0, 0.0, 0.0), [(400.0, 0.0)])
    (fault,) = facts_of(small_map.load(tmp_path)).faults
    assert fault.endswith("there (800 m): road 1 and road 2, all lanes together")
