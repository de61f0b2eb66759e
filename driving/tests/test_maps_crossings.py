"""Roads that cross without a junction: vehicles cross there one after the other, as in a junction."""

import math
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv
from athrl_driving.maps import Town, load_town
from athrl_driving.maps.crossings import FOUND
from athrl_driving.maps.lying_over import FOUND as LYING_OVER
from athrl_driving.traffic import starting_places

from driving.tests.small_map import SmallMap
from driving.tests.test_traffic_open import drive_and_check, placed

BEND = 1.5 * math.pi
"""Radians of each end of a figure of eight."""


def crossed(folder: Path, angle: float = 0.5 * math.pi, lanes: tuple[int, ...] = (1, -1)) -> Path:
    """Write two roads of 300 m that cross in their middle, without a junction."""
    small_map = SmallMap()
    small_map.road(1, (-150.0, 0.0, 0.0), [(300.0, 0.0)], lanes)
    start = (-150.0 * math.cos(angle), -150.0 * math.sin(angle), angle)
    small_map.road(2, start, [(300.0, 0.0)], lanes)
    return small_map.write(folder)


def eight(folder: Path) -> Town:
    """Load a road of two lanes that closes to a figure of eight and crosses itself."""
    radius = 60.0
    line = 2.0 * radius / math.tan(0.25 * math.pi)
    shapes = [(0.5 * line, 0.0), (radius * BEND, 1.0 / radius), (line, 0.0)]
    shapes += [(radius * BEND, -1.0 / radius), (0.5 * line, 0.0)]
    small_map = SmallMap()
    small_map.road(1, (0.0, 0.0, 0.0), shapes, before=(1, "end"), after=(1, "start"))
    return small_map.load(folder)


def places(town: Town) -> list[str]:
    return [finding.place for finding in town.findings if finding.kind == FOUND]


def lifted(path: Path, height: float) -> Path:
    """Write road 2 higher."""
    before, road = path.read_text().split('<road id="2"')
    profile = f'<elevationProfile><elevation s="0" a="{height}" b="0" c="0" d="0"/></elevationProfile>'
    path.write_text(f'{before}<road id="2"{road.replace("</planView>", f"</planView>{profile}", 1)}')
    return path


@pytest.mark.parametrize("angle", [0.5 * math.pi, 0.25 * math.pi, math.radians(150.0), math.radians(10.0)])
@pytest.mark.parametrize("lanes", [(1, -1), (-1,), (2, 1, -1, -2)])
def test_vehicles_on_roads_that_cross_do_not_touch(
    tmp_path: Path, angle: float, lanes: tuple[int, ...]
) -> None:
    town = load_town(crossed(tmp_path, angle, lanes))
    assert len(places(town)) == 1
    assert town.left_out == ()
    vehicles = starting_places(town) // 2
    assert drive_and_check(placed(town, vehicles, 0), 900) > vehicles // 2


def test_place_of_a_crossing_is_told_once(tmp_path: Path) -> None:
    (place,) = places(load_town(crossed(tmp_path)))
    assert place.startswith("road 1 at 1")
    assert " and road 2 at 1" in place


def test_a_road_that_crosses_itself_is_driven_round(tmp_path: Path) -> None:
    town = eight(tmp_path)
    assert len(places(town)) == 1
    assert town.left_out == ()
    assert len(town.junctions) == 1
    assert drive_and_check(placed(town, 40, 0), 1200) == 0


@pytest.mark.parametrize(("height", "found"), [(2.5, 1), (3.5, 0)])
def test_a_bridge_is_no_crossing(tmp_path: Path, height: float, found: int) -> None:
    town = load_town(lifted(crossed(tmp_path), height))
    assert len(places(town)) == found
    assert len(town.junctions) == found


def test_the_faster_road_has_the_right_of_way(tmp_path: Path) -> None:
    path = crossed(tmp_path)
    before, road = path.read_text().split('<road id="2"')
    limit = '<type s="0" type="town"><speed max="5" unit="m/s"/></type>'
    path.write_text(f'{before}<road id="2"{road.replace("<planView>", f"{limit}<planView>", 1)}')
    town = load_town(path)
    of_road = np.array([town.road_name[origin] for origin in town.movements.origin])
    first, second = (town.movements.priority[of_road == name] for name in ("road 1", "road 2"))
    assert first.max() < second.min()


def test_a_crossing_is_no_fault_of_the_file(tmp_path: Path) -> None:
    assert len(places(load_town(crossed(tmp_path), strict=True))) == 1


def test_a_junction_of_roads_that_are_not_connected_is_such_a_crossing(tmp_path: Path) -> None:
    """Junctions of the type crossing, of OpenDRIVE 1.8."""
    path = crossed(tmp_path)
    sections = "".join(
        f'<roadSection id="{road}" roadId="{road}" sStart="140" sEnd="160"/>' for road in (1, 2)
    )
    junction = f'<junction id="50" name="level" type="crossing">{sections}</junction>'
    path.write_text(path.read_text().replace("</OpenDRIVE>", f"{junction}</OpenDRIVE>"))
    town = load_town(path)
    assert len(places(town)) == len(town.findings) == len(town.junctions) == 1


@pytest.mark.parametrize(("beside", "metres"), [(0.0, 600.0), (1.0, 200.0), (3.5, 0.0)])
def test_roads_that_lie_on_each_other_are_told_of(tmp_path: Path, beside: float, metres: float) -> None:
    small_map = SmallMap()
    lanes = (1, -1) if beside == 0.0 else (-1,)
    small_map.road(1, (0.0, 0.0, 0.0), [(300.0, 0.0)], lanes)
    small_map.road(2, (0.0 if beside == 0.0 else 100.0, beside, 0.0), [(300.0, 0.0)], lanes)
    found = [finding for finding in small_map.load(tmp_path).findings if finding.kind == LYING_OVER]
    assert [finding.metres for finding in found] == ([pytest.approx(metres, abs=8.0)] if metres else [])
    assert all(finding.place == "road 1 and road 2, all lanes together" for finding in found)


def test_no_town_has_such_a_crossing() -> None:
    for name in ("town02", "town03", "town04"):
        assert load_town(name).findings == ()


def test_the_ego_drives_over_such_a_crossing(tmp_path: Path) -> None:
    start = {"start": ("road 1", -1, 20.0), "destination": ("road 1", -1, 280.0)}
    env = TownEnv({"vehicles_count": 12, "episode_ticks": 1500, **start}, map=str(crossed(tmp_path)))
    for seed in range(4):
        env.reset(seed=seed)
        driver, ended = RuleBasedDriver(), False
        while not ended:
            *_, terminated, truncated, info = env.step(driver.act(env))
            ended = terminated or truncated
        assert info["metrics"]["success"] == 1.0
