"""Reading files: a crossing with traffic lights, forks, levels, and every mistake named with its place."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps import MapError, load_town

from driving.tests.written_maps import (
    HALF_LANE,
    are_in_conflict,
    crossing,
    element,
    greens_overlap,
    lane,
    linked,
    movement,
    road,
    town_from,
)


def test_a_crossing_is_read_whole(tmp_path: Path) -> None:
    town = town_from(tmp_path, crossing())
    assert len(town.movements.length) == 12 + 4
    assert sorted(junction.kind for junction in town.junctions) == ["bend"] * 4 + ["crossing"]
    assert town.junction_arms == {4: 1, 1: 4}
    assert town.left_out == ()
    assert len(town.signals.cycle) == 0
    assert (town.movements.signal == -1).all()
    for origin, turn in ((1, 2), (2, 1), (3, 0)):
        first = town.movements.lane_start[movement(town, 0, origin)]
        # In OpenDRIVE's frame the arms are numbered counter-clockwise: the next one is to the right.
        assert town.graph.turn[town.movements.lane[first]] == turn


def test_movements_that_cross_or_merge_are_in_conflict(tmp_path: Path) -> None:
    town = town_from(tmp_path, crossing())
    straight, across = movement(town, 0, 2), movement(town, 1, 3)
    oncoming, left = movement(town, 2, 0), movement(town, 2, 1)
    right = movement(town, 1, 2)
    assert are_in_conflict(town, straight, across)
    assert are_in_conflict(town, straight, left)
    assert are_in_conflict(town, straight, right)
    assert not are_in_conflict(town, straight, oncoming)
    assert not are_in_conflict(town, right, oncoming)


@pytest.mark.parametrize(("height", "conflict"), [(0.0, True), (2.0, True), (5.0, False)])
def test_an_overpass_is_no_crossing(tmp_path: Path, height: float, conflict: bool) -> None:
    text = crossing()
    for road_id in (113, 131):  # they arch over the others
        before, after = text.split(f'<road id="{road_id}"')
        length = float(re.findall(r'length="([^"]+)"', after)[0])
        arch = f'a="0.0" b="{4 * height / length}" c="{-4 * height / length**2}" d="0.0"'
        after = re.sub(r'a="0.0" b="[^"]*" c="[^"]*" d="[^"]*"', arch, after, count=1)
        text = f'{before}<road id="{road_id}"{after}'
    town = town_from(tmp_path, text)
    assert are_in_conflict(town, movement(town, 0, 2), movement(town, 1, 3)) == conflict


def test_lights_of_one_controller_are_one_group(tmp_path: Path) -> None:
    controllers = "".join(
        element(
            "controller", "".join(element("control", signalId=f"s{arm}") for arm in arms), id=f"c{arms[0]}"
        )
        for arms in ((0, 2), (1, 3))
    )
    town = town_from(tmp_path, crossing(signals=True, more=controllers))
    signal = town.movements.signal
    assert len(town.signals.cycle) == 2
    assert signal[movement(town, 0, 2)] == signal[movement(town, 2, 0)] == signal[movement(town, 0, 3)]
    assert signal[movement(town, 0, 2)] != signal[movement(town, 1, 3)]
    assert not greens_overlap(town, 0, 1)
    np.testing.assert_allclose(town.signals.cycle, 40.0)


def test_greens_of_conflicting_lights_do_not_overlap(tmp_path: Path) -> None:
    town = town_from(tmp_path, crossing(signals=True))
    assert len(town.signals.cycle) == 4
    signal, start = town.movements.signal, town.movements.conflict_start
    first = np.repeat(signal, np.diff(start))
    for a, b in zip(first.tolist(), signal[town.movements.conflict].tolist(), strict=True):
        if a >= 0 and b >= 0 and a != b:
            assert town.signals.cycle[a] == town.signals.cycle[b]
            assert not greens_overlap(town, a, b)
    governed = [town.road_name[index] for index in town.movements.origin[signal >= 0]]
    assert len(governed) == 12


def test_a_light_holds_for_the_lanes_that_it_names(tmp_path: Path) -> None:
    text = crossing(signals=True).replace("</signal>", '<validity fromLane="-1" toLane="-1"/></signal>')
    assert len(town_from(tmp_path, text).signals.cycle) == 0


def test_the_files_priorities_are_followed(tmp_path: Path) -> None:
    rule = element("priority", high=102, low=113) + element("priority", high=102, low=131)
    town = town_from(tmp_path, crossing(more_in_junction=rule))
    assert town.movements.yields[movement(town, 1, 3)]
    assert not town.movements.yields[movement(town, 0, 2)]
    assert town.movements.priority[movement(town, 0, 2)] < town.movements.priority[movement(town, 1, 3)]


def test_lanes_that_lead_nowhere_are_left_out(tmp_path: Path) -> None:
    stub = road(50, "<line/>", (300, 0, 0), 40, element("right", lane(-1)), name="stub")
    town = town_from(tmp_path, crossing(more=stub))
    assert town.left_out == (("stub", -1, 40.0),)
    assert "stub" not in town.road_name


def test_a_fork_of_lanes_without_a_junction_becomes_one(tmp_path: Path) -> None:
    """Two roads leave the end of one and meet at the start of another: merging movements conflict."""

    def loop(
        number: int, shape: str, start: tuple[float, float, float], length: float, ends: tuple[int, int]
    ) -> str:
        links = linked("predecessor", ends[0], "end") + linked("successor", ends[1], "start")
        lanes = element("right", lane(-1, before=-1, after=-1))
        return road(number, shape, start, length, lanes, links, HALF_LANE)

    arc = element("arc", curvature=1.0 / 20.0)
    text = loop(1, "<line/>", (0, 0, 0), 200, (2, 3))
    text += loop(3, arc, (200, 0, 0), 20.0 * math.pi, (1, 4))
    text += loop(4, "<line/>", (200, 40, math.pi), 200, (3, 2)) + loop(
        5, "<line/>", (200, 40, math.pi), 200, (3, 2)
    )
    text += loop(2, arc, (0, 40, math.pi), 20.0 * math.pi, (4, 1))
    town = town_from(tmp_path, element("OpenDRIVE", text))
    start = [town.road_name[index] for index in town.movements.origin]
    end = [town.road_name[index] for index in town.movements.exit]
    assert sorted(zip(start, end, strict=True)) == [
        ("road 3", "road 4"), ("road 3", "road 5"), ("road 4", "road 2"), ("road 5", "road 2")
    ]  # fmt: skip
    merging = [place for place, name in enumerate(end) if name == "road 2"]
    assert are_in_conflict(town, *merging)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("</OpenDRIVE>", ""), r"map.xodr: line \d+: this is not well-formed XML: .+"),
        (("OpenDRIVE", "OpenScenario"), r"line 1: the root is <OpenScenario>, it must be"),
        (('id="0" length="60.0"', 'id="0"'), r"map.xodr: road 0, line \d+: <road> has no attribute 'length'"),
        (('id="0" length="60.0"', 'id="0" length="far"'), r"road 0, line \d+: length of <road> is 'far', it"),
        (('hdg="0.0"', 'hdg="nan"'), r"road 0, line \d+: hdg of <geometry> is 'nan', it must be a number"),
        (("<line/>", "<bezier/>"), r"road 0, line \d+: a <geometry> must be one of: line, arc"),
        (('a="3.5"', 'a="-3.5"'), r"road 0, lane 1, line \d+: its width is -3.500 m at s = 0.00 m"),
        (('contactPoint="end"', 'contactPoint="middle"'), r"road 200, line \d+: contactPoint is 'middle'"),
        (('x="12.0"', 'x="11.0"'), r"road \d+, lane -?1, line \d+: it ends \d.\d+ m from lane -?1 of"),
        (('type="driving"', 'type="sidewalk"'), r"map.xodr: there is no driving lane in the file, only side"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_place(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    old, new = change
    everywhere = "driving" in old or old == "OpenDRIVE"
    text = crossing()
    assert old in text
    wrong = text.replace(old, new) if everywhere else text.replace(old, new, 1)
    with pytest.raises(MapError, match=message) as caught:
        town_from(tmp_path, wrong)
    assert "\n" not in str(caught.value)


def test_a_gap_in_a_reference_line_is_refused(tmp_path: Path) -> None:
    parts = "".join(
        element("geometry", "<line/>", s=s, x=s + shift, y=0, hdg=0, length=25)
        for s, shift in ((0, 0), (25, 0.5))
    )
    lanes = element("lanes", element("laneSection", element("right", lane(-1)), s=0))
    text = element("road", element("planView", parts) + lanes, id=3, length=50)
    with pytest.raises(
        MapError, match=r"road 3, line \d+: the reference line jumps by 0.500 m at s = 25.000 m"
    ):
        town_from(tmp_path, element("OpenDRIVE", text))


def test_a_file_that_is_not_there_is_named() -> None:
    with pytest.raises(MapError, match=r"nowhere.xodr: there is no such file"):
        load_town("nowhere.xodr")


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    first = town_from(tmp_path, crossing())
    assert load_town(tmp_path / "map.xodr") is first
    second = town_from(tmp_path, crossing(arms=(0, 1, 2)))
    assert len(second.movements.length) < len(first.movements.length)


def loop_of_roads(sections: str, *, marks: str = "broken") -> str:
    """A closed loop of two straights and two half circles, lanes -1 and -2; the first straight is given."""
    mark = element("roadMark", sOffset=0, type=marks)
    both = "".join(lane(number, before=number, after=number) for number in (-1, -2)).replace(
        "<width", mark + "<width"
    )
    arc = element("arc", curvature=1.0 / 30.0)
    half = 30.0 * math.pi
    places = {2: (200.0, 0.0, 0.0), 3: (200.0, 60.0, math.pi), 4: (0.0, 60.0, math.pi)}
    text = ""
    for number, place in places.items():
        links = linked("predecessor", number - 1, "end") + linked("successor", number % 4 + 1, "start")
        shape, length = ("<line/>", 200.0) if number == 3 else (arc, half)
        text += road(number, shape, place, length, element("right", both), links, HALF_LANE)
    plan = element("planView", element("geometry", "<line/>", s=0, x=0, y=0, hdg=0, length=200))
    links = element("link", linked("predecessor", 4, "end") + linked("successor", 2, "start"))
    offset = element("laneOffset", s=0, a=HALF_LANE, b=0, c=0, d=0)
    lanes = element("lanes", offset + (sections or element("laneSection", element("right", both), s=0)))
    return element("OpenDRIVE", element("road", links + plan + lanes, id=1, length=200) + text)


def test_marks_are_followed_where_lanes_can_be_reached_otherwise(tmp_path: Path) -> None:
    solid, broken = (element("roadMark", sOffset=0, type=kind) for kind in ("solid", "broken"))
    lanes = [lane(number, before=number, after=number) for number in (-1, -2)]
    first, second = ("".join(lanes).replace("<width", mark + "<width") for mark in (solid, broken))
    sections = element("laneSection", element("right", first), s=0)
    sections += element("laneSection", element("right", second), s=120)
    town = town_from(tmp_path, loop_of_roads(sections, marks="solid"))
    beside = (town.graph.left >= 0) | (town.graph.right >= 0)
    assert town.graph.length[beside].sum() == pytest.approx(2 * 80.0)
    assert (town.graph.start_x[beside] == 120.0).all()


def test_marks_that_change_within_a_section_are_followed_from_there_on(tmp_path: Path) -> None:
    marks = "".join(
        element("roadMark", sOffset=s, type=kind)
        for s, kind in ((0, "solid"), (60, "broken"), (140, "solid"))
    )
    lanes = "".join(lane(number, before=number, after=number) for number in (-1, -2))
    section = element("laneSection", element("right", lanes.replace("<width", marks + "<width")), s=0)
    town = town_from(tmp_path, loop_of_roads(section, marks="solid"))
    beside = (town.graph.left >= 0) | (town.graph.right >= 0)
    assert town.graph.length[beside].sum() == pytest.approx(2 * 80.0)
    assert (town.graph.start_x[beside] == 60.0).all()


def test_marks_are_ignored_where_lanes_could_not_be_reached_otherwise(tmp_path: Path) -> None:
    town = town_from(tmp_path, loop_of_roads("", marks="solid"))
    assert set(town.lane_id) == {-1, -2}
    assert ((town.graph.left >= 0) | (town.graph.right >= 0)).all()


def test_a_lane_that_opens_and_closes_is_driven_on_where_it_is_wide_enough(tmp_path: Path) -> None:
    parts = ((0, 0, 0), (50, 0, 0.0875), (90, 3.5, 0), (150, 3.5, -0.0875), (190, 0, 0))
    widths = "".join(element("width", sOffset=s, a=a, b=b, c=0, d=0) for s, a, b in parts)
    opening = element("lane", widths, id=-3, type="driving")
    lanes = "".join(lane(number, before=number, after=number) for number in (-1, -2))
    sections = element("laneSection", element("right", lanes + opening), s=0)
    town = town_from(tmp_path, loop_of_roads(sections))
    graph = town.graph
    opening_lanes = np.flatnonzero(town.lane_id == -3)
    assert graph.width[opening_lanes].min() >= 2.2
    assert graph.start_x[opening_lanes].min() == pytest.approx(50.0 + 2.2 / 0.0875, abs=0.1)
    assert graph.dead_end[opening_lanes].sum() == 1
    assert graph.dead_end.sum() == 1
    assert (graph.left[opening_lanes] >= 0).all()
    last = opening_lanes[graph.dead_end[opening_lanes]][0]
    assert graph.start_x[last] + graph.length[last] == pytest.approx(190.0 - 2.2 / 0.0875, abs=0.1)


def test_borders_are_read_as_widths_are(tmp_path: Path) -> None:
    widths = town_from(tmp_path, crossing())
    borders = town_from(tmp_path, crossing().replace("<width", "<border").replace("</width", "</border"))
    np.testing.assert_allclose(widths.graph.start_x, borders.graph.start_x)
    np.testing.assert_allclose(widths.graph.width, borders.graph.width)
