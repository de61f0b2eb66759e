"""Junctions of all types: direct and virtual ones, and what newer versions of the standard add."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps import Town
from athrl_driving.traffic.flow import measure_flow

from driving.tests.written_maps import (
    HALF_LANE,
    NEAR,
    are_in_conflict,
    crossing,
    element,
    lane,
    linked,
    road,
    town_from,
)

STRAIGHT, RADIUS = 200.0, 20.0
BOW = 300.0
"""Metres: the radius of the four arcs by which a road leaves a straight one and joins it again."""


Shapes = list[tuple[float, float]]
"""Curvature (1/m) and length (m) of each part."""


def at_junction(tag: str, number: int) -> str:
    return element(tag, elementType="junction", elementId=number)


def parted_ring(*, contact: bool = True, named_lanes: bool = True) -> str:
    """Return a ring on which roads 4 and 5 leave road 3 and join road 2 again, by direct junctions."""

    def part(number: int, shapes: Shapes, start: tuple[float, float, float], links: str) -> str:
        lanes = element("right", lane(-1, before=-1, after=-1))
        plan, s = "", 0.0
        for curvature, length in shapes:
            x, y, heading = start
            shape = element("arc", curvature=curvature) if curvature else "<line/>"
            plan += element("geometry", shape, s=s, x=x, y=y, hdg=heading, length=length)
            chord = length * float(np.sinc(0.5 * curvature * length / math.pi))
            angle = heading + 0.5 * curvature * length
            start = (x + chord * math.cos(angle), y + chord * math.sin(angle), heading + curvature * length)
            s += length
        offset = element("laneOffset", s=0, a=HALF_LANE, b=0, c=0, d=0)
        section = element("lanes", offset + element("laneSection", lanes, s=0))
        content = element("link", links) + element("planView", plan) + section
        return element("road", content, id=number, length=s, junction=-1)

    def connection(number: int, incoming: int, after: int, end: str) -> str:
        link = element("laneLink", **{"from": -1, "to": -1, "overlapZone": 40}) if named_lanes else ""
        where = {"contactPoint": end} if contact else {}
        return element("connection", link, id=number, incomingRoad=incoming, linkedRoad=after, **where)

    bow = BOW * math.asin(0.25 * STRAIGHT / BOW)
    half = [(1.0 / RADIUS, RADIUS * math.pi)]
    there, back = [(0.0, STRAIGHT)], [(sign / BOW, bow) for sign in (-1.0, 1.0, 1.0, -1.0)]
    text = part(1, there, (0, 0, 0), linked("predecessor", 2, "end") + linked("successor", 3, "start"))
    text += part(3, half, (STRAIGHT, 0, 0), linked("predecessor", 1, "end") + at_junction("successor", 30))
    for number, shapes in ((4, there), (5, back)):
        links = at_junction("predecessor", 30) + at_junction("successor", 31)
        text += part(number, shapes, (STRAIGHT, 2 * RADIUS, math.pi), links)
    links = at_junction("predecessor", 31) + linked("successor", 1, "start")
    text += part(2, half, (0, 2 * RADIUS, math.pi), links)
    leaving = connection(0, 3, 4, "start") + connection(1, 3, 5, "start")
    joining = connection(0, 2, 4, "end") + connection(1, 2, 5, "end")
    text += element("junction", leaving, id=30, type="direct")
    text += element("junction", joining, id=31, type="direct")
    return element("OpenDRIVE", text)


def ways(town: Town) -> list[tuple[str, str]]:
    """Return the roads that each movement leads from and to."""
    names = town.road_name
    pairs = zip(town.movements.origin.tolist(), town.movements.exit.tolist(), strict=True)
    return sorted((names[origin], names[to]) for origin, to in pairs)


PARTED = [("road 3", "road 4"), ("road 3", "road 5"), ("road 4", "road 2"), ("road 5", "road 2")]


def test_a_direct_junction_parts_and_joins_roads(tmp_path: Path) -> None:
    town = town_from(tmp_path, parted_ring())
    assert ways(town) == PARTED
    assert not town.findings
    joining = [place for place, exit in enumerate(town.movements.exit) if town.road_name[exit] == "road 2"]
    assert are_in_conflict(town, *joining)


def test_traffic_flows_through_direct_junctions(tmp_path: Path) -> None:
    """The lanes lie over each other for 40 m where they part: there no vehicle may be beside another."""
    flow = measure_flow(town_from(tmp_path, parted_ring()), vehicles=12, seed=0, minutes=3.0)
    assert flow.colliding_pairs == 0
    assert flow.share_of_free_flow > 0.5


@pytest.mark.parametrize("missing", ["named_lanes", "contact"])
def test_what_a_connection_does_not_say_follows_from_the_roads(tmp_path: Path, missing: str) -> None:
    assert ways(town_from(tmp_path, parted_ring(**{missing: False}))) == PARTED


def test_a_road_with_both_ends_at_one_direct_junction_is_linked_at_the_nearer(tmp_path: Path) -> None:
    text = parted_ring()
    before, after = text.split('<junction id="30"', 1)
    joined = before + '<junction id="30"' + after.replace("</junction>", "", 1)
    joined = joined.replace('<junction id="31" type="direct">', "")
    assert ways(town_from(tmp_path, joined.replace('elementId="31"', 'elementId="30"'))) == PARTED


def same_town(town: Town, other: Town) -> bool:
    pairs = ((town.graph, other.graph), (town.movements, other.movements), (town.signals, other.signals))
    arrays = (columns for pair in pairs for columns in zip(*pair, strict=True))
    return all(np.array_equal(one, two) for one, two in arrays)


def linked_by_connections_only(text: str) -> str:
    """Return the map without the links of its connecting roads' lanes to the lanes before them."""
    return re.sub(r'<predecessor id="[^"]*">\s*</predecessor>', "", text)


def test_a_common_junction_may_leave_out_contact_points_and_lanes(tmp_path: Path) -> None:
    expected, text = town_from(tmp_path, crossing()), linked_by_connections_only(crossing())
    assert same_town(town_from(tmp_path, text), expected)
    without_contact = re.sub(r'(<connection [^>]*?) contactPoint="start"', r"\1", text)
    assert same_town(town_from(tmp_path, without_contact), expected)
    # Where the turns lead from lane -1 to lane -1 the file need not say which lanes are linked.
    without_lanes = re.sub(r'<laneLink from="-1" to="-1">\s*</laneLink>', "", text)
    assert same_town(town_from(tmp_path, without_lanes), expected)


def test_a_connection_with_a_road_that_was_cut_away_is_left_out(tmp_path: Path) -> None:
    text = re.sub(r'<road id="101".*?</road>', "", crossing(), flags=re.DOTALL)
    town = town_from(tmp_path, text)
    (finding,) = town.findings
    assert finding.kind == "a link to a road that is not in the file was passed over"
    assert "junction 9, line" in finding.place
    assert len(town.movements.length) == len(town_from(tmp_path, crossing()).movements.length) - 1


def with_driveway(text: str) -> str:
    """Return the crossing with a driveway that leaves road 0 in its middle by a virtual junction."""
    x, y = NEAR + 30.0, -HALF_LANE
    middle = element("predecessor", elementType="road", elementId=0, elementS=30, elementDir="+")
    lanes = element("right", lane(-1, before=-1, after=-1))
    branch = road(
        70, "<line/>", (x, y, -0.5), 20, lanes, middle + linked("successor", 71, "start"), junction=7
    )
    yard = road(71, "<line/>", (x + 17.6, y - 9.6, -0.5), 50, lanes, linked("predecessor", 70, "end"))
    connection = element(
        "connection",
        element("laneLink", **{"from": -1, "to": -1}),
        id=0,
        incomingRoad=0,
        connectingRoad=70,
        contactPoint="start",
    )
    span = {"mainRoad": 0, "sStart": 25, "sEnd": 35, "orientation": "+"}
    virtual = element("junction", connection, id=7, type="virtual", **span)
    return text.replace("</OpenDRIVE>", f"{branch}{yard}{virtual}</OpenDRIVE>")


def test_a_virtual_junction_leaves_its_main_road_as_it_is(tmp_path: Path) -> None:
    expected, town = town_from(tmp_path, crossing()), town_from(tmp_path, with_driveway(crossing()))
    kind = "a virtual junction was left out: its main road is driven, what joins it there is not"
    assert kind in {finding.kind for finding in town.findings}
    assert ways(town) == ways(expected)
    kept = np.isin(town.road_name, expected.road_name)
    assert np.array_equal(town.graph.length[kept], expected.graph.length)
    assert "road 70" not in town.road_name


def test_elements_of_newer_versions_that_no_vehicle_needs_change_nothing(tmp_path: Path) -> None:
    corners = element("cornerLocal", u=0, v=0, z=0) + element("cornerLocal", u=1, v=0, z=0)
    boundary = element("boundary", element("segment", corners, type="lane", roadId=0))
    surface = element("elevationGrid", element("elevation", center=0), gridSpacing=1, sStart=0)
    path = element("crossPath", id=1, crossingRoad=0, roadAtStart=1, roadAtEnd=2)
    possible = element(
        "connection",
        element("predecessor", elementType="road", elementId=0, elementS=3),
        id=99,
        type="virtual",
    )
    priorities = element("priority", high=101) + element("priority", low=102)
    inside = boundary + surface + path + possible + priorities
    group = element("junctionGroup", element("junctionReference", junction=9), id=1, type="roundabout")
    text = crossing(more_in_junction=inside, more=group).replace(
        "<junction id", '<junction type="default" id'
    )
    text = text.replace('type="driving"', 'type="driving" direction="both" advisory="none"')
    town = town_from(tmp_path, text)
    assert same_town(town, town_from(tmp_path, crossing()))
    assert not town.findings


def test_links_of_temporary_lanes_are_passed_over(tmp_path: Path) -> None:
    temporary = '<laneLink from="5" to="-7" fromLayer="temporary"/><laneLink from="1"'
    text = crossing().replace('<laneLink from="1"', temporary)
    assert same_town(town_from(tmp_path, text), town_from(tmp_path, crossing()))


def test_a_lane_that_all_share_is_driven_on(tmp_path: Path) -> None:
    shared = crossing().replace('type="driving"', 'type="shared"')
    assert same_town(town_from(tmp_path, shared), town_from(tmp_path, crossing()))
