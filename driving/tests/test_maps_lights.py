"""Traffic lights as files have them: by reference, with controllers that contradict each other, misplaced."""

import itertools
import math
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps import MapError, Town, load_town
from athrl_driving.maps.opendrive.reading_signals import UNREADABLE
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.signals import GREEN, RED
from athrl_driving.traffic.signals import light as light_of
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import environment_views, new_traffic
from athrl_driving.traffic.tick import tick
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from driving.tests.written_maps import (
    are_in_conflict,
    controller,
    crossing,
    element,
    greens_overlap,
    light,
    movement,
    town_from,
    with_signals,
)

ARMS = range(4)
WAYS = list(itertools.permutations(ARMS, 2))


def kinds(town: Town) -> set[str]:
    return {finding.kind for finding in town.findings}


def governed(town: Town) -> list[tuple[int, int]]:
    """Return which ways through the crossing have lights."""
    return [way for way in WAYS if town.movements.signal[movement(town, *way)] >= 0]


def referred_to(on: str, arms: Iterable[int] = ARMS, **attributes: object) -> str:
    """Return a crossing whose lights stand beyond it and hold by reference.

    References are on the incoming roads (at their stop lines) or on the connecting roads, as in CARLA's newer
    towns, where they name the lane and their orientation points the other way.
    """
    text = crossing()
    for arm in arms:
        beyond = light("signal", f"s{arm}", s=4.0, orientation="+", lanes=(0, 0))
        text = with_signals(text, (arm + 2) % 4, beyond)
        if on == "incoming":
            here = light("signalReference", f"s{arm}", s=0.2, lanes=(1, 1), **attributes)
            text = with_signals(text, arm, here)
            continue
        for other in ARMS:
            if other != arm:
                here = light("signalReference", f"s{arm}", s=0.6, lanes=(-1, -1), **attributes)
                text = with_signals(text, 100 + 10 * arm + other, here)
    return text


def with_controllers(text: str, *groups: Iterable[str]) -> str:
    """Return the map with a controller for each group of signals, which the crossing names in order."""
    names = [f"c{number}" for number in range(len(groups))]
    ours = "".join(
        element("controller", id=name, type=0, sequence=number) for number, name in enumerate(names)
    )
    all_controllers = "".join(itertools.starmap(controller, zip(names, groups, strict=True)))
    before, after = text.split('<junction id="9"', 1)
    junction, after = after.split("</junction>", 1)
    end = after.replace("</OpenDRIVE>", f"{all_controllers}</OpenDRIVE>")
    return f'{before}<junction id="9"{junction}{ours}</junction>{end}'


@pytest.mark.parametrize("on", ["incoming", "connecting"])
def test_lights_by_reference_are_those_that_stand_there(tmp_path: Path, on: str) -> None:
    groups = (["s0", "s2"], ["s1", "s3"])
    standing = town_from(tmp_path, with_controllers(crossing(signals=True), *groups))
    referred = town_from(tmp_path, with_controllers(referred_to(on), *groups))
    assert governed(referred) == WAYS
    np.testing.assert_array_equal(referred.movements.signal, standing.movements.signal)
    for one, other in zip(referred.signals, standing.signals, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_reference_without_lanes_holds_for_all_in_its_direction(tmp_path: Path) -> None:
    text = with_signals(crossing(), 2, light("signal", "s", orientation="+", lanes=(0, 0)))
    for orientation, expected in (("-", 3), ("none", 3), ("+", 0)):
        there = with_signals(text, 0, light("signalReference", "s", orientation=orientation))
        town = town_from(tmp_path, there)
        assert len(governed(town)) == expected, orientation


def test_a_light_that_names_no_lane_and_is_not_referred_to_is_left_out_with_one_warning(
    tmp_path: Path,
) -> None:
    text = crossing()
    for arm in ARMS:
        text = with_signals(text, arm, light("signal", f"s{arm}", lanes=(0, 0)))
    town = town_from(tmp_path, text)
    assert not governed(town)
    assert kinds(town) == {"a traffic light that no way through a junction passes was left out"}
    assert len(town.findings) == 4


def test_lanes_that_lie_against_a_lights_orientation_are_meant(tmp_path: Path) -> None:
    town = town_from(tmp_path, referred_to("connecting", orientation="-"))
    assert governed(town) == WAYS
    assert kinds(town) == {"a traffic light's lanes lie against its orientation: it holds for the lanes"}
    assert not town_from(tmp_path, referred_to("connecting", orientation="+")).findings


def test_a_light_without_a_controller_changes_with_its_approach(tmp_path: Path) -> None:
    town = town_from(tmp_path, referred_to("connecting", orientation="+"))
    assert len(town.signals.cycle) == 4
    for arm in ARMS:
        own = {town.movements.signal[movement(town, arm, other)] for other in ARMS if other != arm}
        assert len(own) == 1


def test_one_light_that_two_approaches_refer_to_changes_for_both(tmp_path: Path) -> None:
    text = with_signals(crossing(), 1, light("signal", "s", lanes=(0, 0)))
    for arm in (0, 2):
        text = with_signals(text, arm, light("signalReference", "s"))
    signal = town_from(tmp_path, text).movements.signal
    assert set(signal.tolist()) == {-1, 0}


def crosses(town: Town, first: int, second: int) -> bool:
    """Tell from the lanes alone whether two movements cut each other's way from the side."""
    graph, origins = town.graph, town.movements.origin[[first, second]]
    heading = graph.start_heading[origins] + graph.curvature[origins] * graph.length[origins]
    return are_in_conflict(town, first, second) and abs(math.sin(heading[1] - heading[0])) > 0.8


def check_cycle(town: Town) -> None:
    """Check that nothing that crosses is open at once, and that each group gets its green."""
    signals, signal = town.signals, town.movements.signal
    assert set(signal.tolist()) - {-1} == set(range(len(signals.cycle)))
    for first, second in itertools.combinations(np.flatnonzero(signal >= 0).tolist(), 2):
        one, other = int(signal[first]), int(signal[second])
        if crosses(town, first, second):
            assert one != other
        if one != other and are_in_conflict(town, first, second):
            assert signals.cycle[one] == signals.cycle[other]
            assert not greens_overlap(town, one, other)
    assert ((signals.green_until - signals.green_from) % signals.cycle == 15.0).all()


def test_a_controller_of_ways_that_cross_is_separated(tmp_path: Path) -> None:
    town = town_from(tmp_path, with_controllers(referred_to("incoming"), ["s0", "s1", "s2", "s3"]))
    signal = town.movements.signal
    assert governed(town) == WAYS
    check_cycle(town)
    assert len(town.signals.cycle) == 2  # opposite arms stay together
    assert signal[movement(town, 0, 1)] == signal[movement(town, 2, 0)]
    assert "lights that change together were separated, as their ways cross" in kinds(town)


def test_a_controller_of_two_junctions_is_one_of_each(tmp_path: Path) -> None:
    text = with_signals(referred_to("incoming", arms=[0]), 200, light("signal", "turn", orientation="+"))
    town = town_from(tmp_path, with_controllers(text, ["s0", "turn"]))
    at_turn = town.movements.signal[movement(town, 0, 0)]
    assert len(town.signals.cycle) == 2
    assert at_turn >= 0
    assert at_turn != town.movements.signal[movement(town, 0, 2)]


def test_a_light_of_two_controllers_follows_the_one_that_its_junction_names(tmp_path: Path) -> None:
    elsewhere = controller("other", ["s0", "s1"])
    text = with_controllers(referred_to("incoming"), ["s0", "s2"], ["s1", "s3"])
    before, roads = text.split("<OpenDRIVE>", 1)
    town = town_from(tmp_path, f"{before}<OpenDRIVE>{elsewhere}{roads}")
    assert len(town.signals.cycle) == 2
    assert town.movements.signal[movement(town, 0, 2)] == town.movements.signal[movement(town, 2, 0)]
    assert kinds(town) == {"a light of several controllers was given to the first that its junction names"}
    check_cycle(town)


def test_what_controllers_and_references_name_but_is_not_there_is_one_warning_each(tmp_path: Path) -> None:
    text = with_controllers(referred_to("incoming"), ["s0", "s2", "gone", "gone too"], ["s1", "s3"])
    text = with_signals(text, 3, light("signalReference", "nowhere"))
    text = text.replace('<junction id="9" name="the crossing">', '<junction id="9"><controller id="c9"/>')
    town = town_from(tmp_path, text)
    assert kinds(town) == {
        "a reference to a signal that is not there was left out",
        "a controller's signal that is not there was left out",
        "a junction's controller that is not there was left out",
    }
    assert governed(town) == WAYS


@pytest.mark.parametrize(
    ("attributes", "ways", "finding"),
    [
        ({"type": 1000001}, 3, ""),
        ({"type": 1000001, "subtype": 10, "country": "DE"}, 3, ""),
        ({"type": 1000011, "subtype": 10}, 3, ""),
        ({"type": 1000010, "subtype": 20}, 3, ""),
        ({"type": 1000002}, 0, ""),
        ({"type": 1000013}, 0, ""),
        ({"type": 274}, 0, ""),
        ({"type": 1000099}, 0, "a light of a type that is not known was left out"),
        ({"dynamic": "no"}, 0, "a traffic light that never changes (dynamic is no) was left out"),
    ],
)
def test_lights_for_vehicles_are_told_from_others(
    tmp_path: Path, attributes: dict[str, object], ways: int, finding: str
) -> None:
    town = town_from(tmp_path, with_signals(crossing(), 0, light("signal", "s", **attributes)))
    assert len(governed(town)) == ways
    assert kinds(town) == ({finding} if finding else set())


def test_a_light_that_does_not_say_whether_it_changes_is_one(tmp_path: Path) -> None:
    text = with_signals(crossing(), 0, light("signal", "s").replace('dynamic="yes"', ""))
    assert len(governed(town_from(tmp_path, text))) == 3


def test_a_light_beyond_the_end_of_its_road_is_taken_to_the_end(tmp_path: Path) -> None:
    town = town_from(tmp_path, with_signals(crossing(), 0, light("signal", "s", s=-4.0)))
    assert len(governed(town)) == 3
    (finding,) = town.findings
    assert finding.kind == "a traffic light beyond its road's end was taken to the end"
    assert finding.metres == 4.0


@pytest.mark.parametrize(("s", "ways"), [(0.0, 3), (49.0, 3), (51.0, 0), (70.0, 0), (119.0, 0)])
def test_a_light_in_the_middle_of_a_road_is_for_pedestrians(tmp_path: Path, s: float, ways: int) -> None:
    text = with_signals(crossing(length=120.0), 0, light("signal", "s", s=s))
    town = town_from(tmp_path, text)
    assert len(governed(town)) == ways
    left_out = {"a traffic light that no way through a junction passes was left out"}
    assert kinds(town) == (set() if ways else left_out)


def test_a_strict_map_has_lights_as_the_standard_allows_them(tmp_path: Path) -> None:
    path = tmp_path / "strict.xodr"
    path.write_text(with_signals(crossing(length=120.0), 0, light("signal", "in the middle", s=60)))
    assert len(load_town(path, strict=True).findings) == 1
    path.write_text(referred_to("connecting", orientation="-"))
    with pytest.raises(MapError, match=r"strict.xodr: road 101, .+ a traffic light's lanes lie against"):
        load_town(path, strict=True)


@pytest.mark.parametrize("bound", ["opendrive.model.MOST_LIGHTS", "governing_lights.MOST_LIGHT_STEPS"])
def test_too_many_lights_are_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bound: str
) -> None:
    monkeypatch.setattr(f"athrl_driving.maps.{bound}", 10)
    with pytest.raises(MapError, match=r"map.xodr: .+ traffic lights") as caught:
        town_from(tmp_path, referred_to("connecting"))
    assert "\n" not in str(caught.value)


def test_traffic_stops_at_red_lights_by_reference(tmp_path: Path) -> None:
    text = with_controllers(referred_to("connecting"), ["s0", "s2"], ["s1", "s3"])
    town = town_from(tmp_path, text)
    traffic, nobody, nowhere = new_traffic(town, 1, 12), np.zeros(EGO_SIZE), np.full(1, -1)
    place_vehicles(traffic, 0, np.random.default_rng(1), None, 0.0, nobody)
    view, background = environment_views(traffic, 0), traffic.background
    entered, stood_at_red, seen = 0, 0, set()
    ways = {movement(town, *way) for way in WAYS}
    for _ in range(1800):
        before = background.lane[0].copy()
        lights = {way: light_of.py_func(view, way) for way in ways}
        seen |= set(lights.values())
        tick(traffic, 0, nobody, nowhere, 0.1)
        was_on, is_on = town.graph.movement[before], town.graph.movement[background.lane[0]]
        for way in is_on[(was_on < 0) & (is_on >= 0)].tolist():
            if way in ways:
                entered += 1
                assert lights[way] != RED
        waiting = (background.speed[0] < 0.1) & np.isin(background.lane[0], town.movements.origin)
        stood_at_red += int(waiting.sum()) if RED in lights.values() else 0
    assert entered > 20
    assert stood_at_red > 100
    assert {GREEN, RED} <= seen


SIGNALS = [f"s{arm}" for arm in ARMS]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    on=st.lists(st.sampled_from(["own", "incoming", "connecting", "nothing"]), min_size=4, max_size=4),
    same=st.lists(st.sampled_from(SIGNALS), min_size=4, max_size=4),
    groups=st.lists(st.lists(st.sampled_from([*SIGNALS, "s9"]), max_size=5), max_size=4),
    at_arms=st.booleans(),
)
def test_no_two_crossing_ways_are_ever_green_together(
    tmp_path: Path, on: list[str], same: list[str], groups: list[list[str]], at_arms: bool
) -> None:
    """However signals, references and controllers are assigned: `same` are the signals of the arms."""
    text = crossing()
    for arm, (where, name) in enumerate(zip(on, same, strict=True)):
        if where == "own":
            text = with_signals(text, arm, light("signal", name))
        elif where == "incoming":
            text = with_signals(text, arm, light("signalReference", name, lanes=(1, 1)))
        elif where == "connecting":
            for other in ARMS:
                if other != arm:
                    there = light("signalReference", name, orientation="+")
                    text = with_signals(text, 100 + 10 * arm + other, there)
        text = with_signals(text, arm, light("signal", f"s{arm}", orientation="+", lanes=(0, 0)))
    if at_arms:
        text = with_controllers(text, *groups)
    town = town_from(tmp_path, text)
    check_cycle(town)
    lit = [arm for arm in ARMS if on[arm] != "nothing"]
    assert sorted({way[0] for way in governed(town)}) == lit


@pytest.mark.parametrize("tag", ["signal", "signalReference"])
@pytest.mark.parametrize(
    ("attribute", "value", "reason"),
    [
        ("s", "far", "s of <{tag}> is 'far', it must be a number"),
        ("s", "nan", "s of <{tag}> is 'nan', it must be a number"),
        ("fromLane", "one", "fromLane of <validity> is 'one', it must be a whole number"),
        ("id", None, "<{tag}> has no attribute 'id'"),
    ],
)
def test_light_that_cannot_be_read_is_left_out_and_the_others_hold(
    tmp_path: Path, tag: str, attribute: str, value: str | None, reason: str
) -> None:
    text = crossing()
    for arm in ARMS:
        text = with_signals(text, arm, light("signal", f"s{arm}", s=0.2, lanes=(1, 1)))
    broken = light(tag, "broken", s=0.3, lanes=(1, 1))
    written = "" if value is None else f'{attribute}="{value}"'
    broken, count = re.subn(rf'\b{attribute}="[^"]*"', written, broken)
    assert count == 1
    town = town_from(tmp_path, with_signals(text, 0, broken))
    assert governed(town) == WAYS
    [finding] = [each for each in town.findings if each.kind == UNREADABLE]
    assert finding.place.startswith("road 0, line ")
    assert finding.place.endswith(reason.format(tag=tag))
    with pytest.raises(MapError, match="that cannot be read would be left out"):
        load_town(tmp_path / "map.xodr", strict=True)
