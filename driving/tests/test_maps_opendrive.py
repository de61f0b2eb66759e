"""Reading files: a crossing with traffic lights, forks, levels, and every mistake named with its place."""

import itertools
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps import MapError, Town, load_town

NEAR, LENGTH, HALF_LANE = 12.0, 60.0, 1.75


def element(tag: str, content: str = "", **attributes: object) -> str:
    text = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    return f"<{tag} {text}>{content}</{tag}>\n"


def lane(number: int, *, before: int | None = None, after: int | None = None, width: float = 3.5) -> str:
    links = element("predecessor", id=before) if before is not None else ""
    links += element("successor", id=after) if after is not None else ""
    widths = element("width", sOffset=0, a=width, b=0, c=0, d=0)
    return element("lane", element("link", links) + widths, id=number, type="driving")


def road(
    number: int,
    shape: str,
    start: tuple[float, float, float],
    length: float,
    lanes: str,
    links: str = "",
    offset: float = 0.0,
    height: float = 0.0,
    more: str = "",
    **attributes: object,
) -> str:
    x, y, heading = start
    plan = element("planView", element("geometry", shape, s=0, x=x, y=y, hdg=heading, length=length))
    profile = element("elevationProfile", element("elevation", s=0, a=height, b=0, c=0, d=0))
    offsets = element("laneOffset", s=0, a=offset, b=0, c=0, d=0)
    section = element("lanes", offsets + element("laneSection", lanes, s=0))
    content = element("link", links) + plan + profile + section + more
    return element("road", content, id=number, length=length, **{"junction": -1, **attributes})


def linked(tag: str, number: int, contact: str) -> str:
    return element(tag, elementType="road", elementId=number, contactPoint=contact)


def connecting(
    number: int,
    junction: int,
    start: tuple[float, float, float],
    shape: str,
    length: float,
    ends: tuple[tuple[int, str, int], tuple[int, str, int]],
    height: float = 0.0,
) -> tuple[str, str]:
    """Return a connecting road and its connection; `ends` are (road, contact, lane) before and after."""
    (before, contact, lane_before), (after, contact_after, lane_after) = ends
    links = linked("predecessor", before, contact) + linked("successor", after, contact_after)
    lanes = element("right", lane(-1, before=lane_before, after=lane_after))
    way = road(number, shape, start, length, lanes, links, HALF_LANE, height, junction=junction)
    link = element("laneLink", **{"from": lane_before, "to": -1})
    return way, element(
        "connection", link, id=number, incomingRoad=before, connectingRoad=number, contactPoint="start"
    )


def crossing(
    arms: Iterable[int] = range(4), signals: bool = False, more: str = "", more_in_junction: str = ""
) -> str:
    """Four roads that meet at the origin, each with a lane in each direction that turns at the far end."""
    result, turns, ways, connections = "", "", "", ""
    for arm in arms:
        angle = 0.5 * math.pi * arm
        cos, sin = round(math.cos(angle)), round(math.sin(angle))
        light = element("signal", id=f"s{arm}", s=0.5, t=3, type=1000001, dynamic="yes", orientation="-")
        lanes = element("left", lane(1)) + element("right", lane(-1))
        links = element("predecessor", elementType="junction", elementId=9)
        links += element("successor", elementType="junction", elementId=20 + arm)
        start = (NEAR * cos, NEAR * sin, angle)
        result += road(
            arm, "<line/>", start, LENGTH, lanes, links, more=element("signals", light if signals else "")
        )
        far = NEAR + LENGTH
        way, connection = connecting(
            200 + arm,
            20 + arm,
            (far * cos + HALF_LANE * sin, far * sin - HALF_LANE * cos, angle),
            element("arc", curvature=1.0 / HALF_LANE),
            math.pi * HALF_LANE,
            ((arm, "end", -1), (arm, "end", 1)),
        )
        turns += way + element("junction", connection, id=20 + arm, name=f"turn {arm}")
    for origin, target in itertools.permutations(arms, 2):
        angle = 0.5 * math.pi * origin
        cos, sin = round(math.cos(angle)), round(math.sin(angle))
        start = (NEAR * cos - HALF_LANE * sin, NEAR * sin + HALF_LANE * cos, angle + math.pi)
        turn = (target - origin) % 4
        radius = {1: -(NEAR - HALF_LANE), 3: NEAR + HALF_LANE}.get(turn, 0.0)
        shape = "<line/>" if turn == 2 else element("arc", curvature=1.0 / radius)
        length = 2.0 * NEAR if turn == 2 else 0.5 * math.pi * abs(radius)
        ends = ((origin, "start", 1), (target, "start", -1))
        way, connection = connecting(100 + 10 * origin + target, 9, start, shape, length, ends)
        ways, connections = ways + way, connections + connection
    junction = element("junction", connections + more_in_junction, id=9, name="the crossing")
    return f"<OpenDRIVE>\n{result}{turns}{ways}{junction}{more}</OpenDRIVE>"


def town_from(folder: Path, text: str) -> Town:
    path = folder / "map.xodr"
    path.write_text(text)
    return load_town(path)


def movement(town: Town, origin: int, target: int) -> int:
    """Return the movement from one arm of the crossing to another."""
    start = [town.road_name[row] for row in town.movements.origin]
    end = [town.road_name[row] for row in town.movements.exit]
    wanted = (f"road {origin}", f"road {target}")
    (found,) = [place for place, names in enumerate(zip(start, end, strict=True)) if names == wanted]
    return found


def are_in_conflict(town: Town, first: int, second: int) -> bool:
    start = town.movements.conflict_start
    return second in town.movements.conflict[start[first] : start[first + 1]]


def test_a_crossing_is_read_whole(tmp_path: Path) -> None:
    town = town_from(tmp_path, crossing())
    assert len(town.movements.length) == 12 + 4
    assert sorted(junction.kind for junction in town.junctions) == ["bend"] * 4 + ["crossing"]
    assert town.junction_arms == {4: 1, 1: 4}
    assert town.left_out == ()
    assert len(town.signals.cycle) == 0
    assert (town.movements.signal == -1).all()
    for origin, turn in ((1, 2), (2, 1), (3, 0)):
        rows = town.movements.lane_start[movement(town, 0, origin)]
        # In OpenDRIVE's frame the arms are numbered counter-clockwise: the next one is to the right.
        assert town.graph.turn[town.movements.lane[rows]] == turn


def test_ways_that_cross_or_merge_are_in_conflict(tmp_path: Path) -> None:
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
    for way in (113, 131):
        before, after = text.split(f'<road id="{way}"')
        text = f'{before}<road id="{way}"' + after.replace('a="0.0"', f'a="{height}"', 1)
    town = town_from(tmp_path, text)
    assert are_in_conflict(town, movement(town, 0, 2), movement(town, 1, 3)) == conflict


def greens_overlap(town: Town, first: int, second: int) -> bool:
    signals = town.signals
    cycle = signals.cycle[first]
    times = np.arange(0.0, cycle, 0.25)

    def is_open(group: int) -> np.ndarray:
        length = (signals.green_until[group] - signals.green_from[group]) % cycle + signals.yellow[group]
        return (times - signals.green_from[group]) % cycle < length

    return bool((is_open(first) & is_open(second)).any())


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
    governed = [town.road_name[row] for row in town.movements.origin[signal >= 0]]
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


def test_a_fork_of_lanes_without_a_junction_is_a_way_through_one(tmp_path: Path) -> None:
    """Two roads leave the end of one and meet at the start of another: whoever merges has to be let in."""

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
    start = [town.road_name[row] for row in town.movements.origin]
    end = [town.road_name[row] for row in town.movements.exit]
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
        (('sOffset="0"', 'sOffset="9"'), r"road 0, lane 1, line \d+: its first <width> or <border> does"),
        (('elementId="0" contactPoint="end"', 'elementId="77" contactPoint="end"'),
         r"road 200, line \d+: it is linked to road 77, which is not there"),
        (('contactPoint="end"', 'contactPoint="middle"'), r"road 200, line \d+: contactPoint is 'middle'"),
        (('<successor id="1">', '<successor id="7">'),
         r"road 0, lane 7, line \d+: it is linked to lane -1 of road 200, but has no lane 7 at its end"),
        (('connectingRoad="101"', 'connectingRoad="999"'), r"junction 9, line \d+: there is no road 999"),
        (('x="12.0"', 'x="11.0"'), r"road \d+, lane -?1, line \d+: it ends \d.\d+ m from lane -?1 of"),
        (('type="driving"', 'type="sidewalk"'), r"map.xodr: there is no driving lane in the file"),
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


def test_a_lane_inside_of_its_curves_centre_is_refused(tmp_path: Path) -> None:
    lanes = element("left", lane(1) + lane(2)) + element("right", lane(-1))
    text = road(4, element("arc", curvature=0.25), (0, 0, 0), 5, lanes)
    with pytest.raises(
        MapError, match=r"road 4, lane 2, line \d+: it lies 5.25 m inside a curve of radius 4.00 m"
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


def test_marks_give_way_where_lanes_could_not_be_reached_otherwise(tmp_path: Path) -> None:
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
    rows = np.flatnonzero(town.lane_id == -3)
    assert graph.width[rows].min() >= 2.2
    assert graph.start_x[rows].min() == pytest.approx(50.0 + 2.2 / 0.0875, abs=0.1)
    assert graph.dead_end[rows].sum() == 1
    assert graph.dead_end.sum() == 1
    assert (graph.left[rows] >= 0).all()
    last = rows[graph.dead_end[rows]][0]
    assert graph.start_x[last] + graph.length[last] == pytest.approx(190.0 - 2.2 / 0.0875, abs=0.1)


def test_borders_are_read_as_widths_are(tmp_path: Path) -> None:
    widths = town_from(tmp_path, crossing())
    borders = town_from(tmp_path, crossing().replace("<width", "<border").replace("</width", "</border"))
    np.testing.assert_allclose(widths.graph.start_x, borders.graph.start_x)
    np.testing.assert_allclose(widths.graph.width, borders.graph.width)
