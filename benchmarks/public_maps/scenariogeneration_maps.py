"""Maps that scenariogeneration writes: what its examples show, each as a small map."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from scenariogeneration import xodr

Maker = Callable[[], xodr.OpenDrive]


def straight_road() -> xodr.OpenDrive:
    """A road of one lane a direction that begins and ends at the map's edge."""
    return _of_roads(xodr.create_road(xodr.Line(300), 1))


def bend_of_clothoids() -> xodr.OpenDrive:
    """A line, a clothoid, an arc, a clothoid, a line."""
    bend = [xodr.Spiral(1e-5, 0.02, 40), xodr.Arc(0.02, length=60), xodr.Spiral(0.02, 1e-5, 40)]
    return _of_roads(xodr.create_road([xodr.Line(100), *bend, xodr.Line(100)], 1))


def road_of_polynomials() -> xodr.OpenDrive:
    """A reference line that is a pair of cubic polynomials."""
    curve = xodr.ParamPoly3(0, 100, 0, 0, 0, 0, 60, -40)
    return _of_roads(xodr.create_road([xodr.Line(100), curve, xodr.Line(100)], 1, 2, 2))


def ring() -> xodr.OpenDrive:
    """Two half circles, two lanes a direction: closed."""
    halves = [xodr.create_road(xodr.Arc(1 / 60, angle=math.pi), number, 2, 2) for number in (1, 2)]
    for own, other in (halves, halves[::-1]):
        own.add_successor(xodr.ElementType.road, other.id, xodr.ContactPoint.start)
        own.add_predecessor(xodr.ElementType.road, other.id, xodr.ContactPoint.end)
    return _of_roads(*halves)


def lanes_that_merge_and_split() -> xodr.OpenDrive:
    """Three lanes become two, and two become three."""
    right = [xodr.LaneDef(80, 140, 3, 2, -3), xodr.LaneDef(220, 280, 2, 3, -3)]
    return _of_roads(xodr.create_road(xodr.Line(400), 1, 2, right))


def road_that_widens() -> xodr.OpenDrive:
    """Lanes of 3 m that become 4 m wide."""
    return _of_roads(xodr.create_road(xodr.Line(300), 1, 1, 2, lane_width=3, lane_width_end=4))


def crossing_of_three() -> xodr.OpenDrive:
    """A junction of three arms, one lane a direction."""
    return _crossing(3, 1)


def crossing_of_four_with_two_lanes() -> xodr.OpenDrive:
    """A junction of four arms, two lanes a direction."""
    return _crossing(4, 2)


def crossing_with_lights() -> xodr.OpenDrive:
    """A junction of four arms with a traffic light at each."""
    return _crossing(4, 1, lights=True)


def junction_of_unequal_roads() -> xodr.OpenDrive:
    """A through road of two lanes a direction, which a road of one lane joins at an angle."""
    roads = [
        xodr.create_road(xodr.Line(150), number, lanes, lanes) for number, lanes in ((1, 2), (2, 1), (3, 2))
    ]
    junction = xodr.CommonJunctionCreator(100, "joining")
    junction.add_incoming_road_cartesian_geometry(roads[0], 0, 0, 0, "successor")
    junction.add_incoming_road_cartesian_geometry(roads[1], 50, 50, 1.5 * math.pi, "predecessor")
    junction.add_incoming_road_cartesian_geometry(roads[2], 100, 0, math.pi, "predecessor")
    junction.add_connection(1, 3)
    junction.add_connection(1, 2, 2, 1)
    junction.add_connection(2, 3, -1, 2)
    return _of_roads(*roads, junction=junction)


def exit_and_entry_by_direct_junctions() -> xodr.OpenDrive:
    """A motorway that a ramp leaves and another one joins, by direct junctions of OpenDRIVE 1.7."""
    wide, narrow, last = (
        xodr.create_road(xodr.Line(length), number, 2, lanes)
        for number, length, lanes in ((1, 250, 3), (2, 250, 2), (3, 250, 3))
    )
    off = xodr.create_road(xodr.Spiral(-1e-5, -0.002, 150), 10, 0, 1)
    on = xodr.create_road(xodr.Spiral(0.002, 1e-5, 150), 20, 0, 1)
    leaving, joining = xodr.DirectJunctionCreator(100, "exit"), xodr.DirectJunctionCreator(200, "entry")
    for road, junction in ((wide, 100), (narrow, 200), (on, 200)):
        road.add_successor(xodr.ElementType.junction, junction)
    for road, junction in ((narrow, 100), (off, 100), (last, 200)):
        road.add_predecessor(xodr.ElementType.junction, junction)
    leaving.add_connection(wide, narrow)
    leaving.add_connection(wide, off, -3, -1)
    joining.add_connection(narrow, last)
    joining.add_connection(on, last, -1, -3)
    return _of_roads(wide, narrow, last, off, on, junction=leaving, second=joining)


def lane_of_another_type() -> xodr.OpenDrive:
    """A one-way road whose outer lane has the type exit."""
    road = xodr.create_road(xodr.Line(300), 1, 0, 3)
    road.lanes.lanesections[0].rightlanes[-1].lane_type = xodr.LaneType.exit
    return _of_roads(road)


def hill_with_superelevation() -> xodr.OpenDrive:
    """A road that rises, falls and leans into its bend."""
    road = xodr.create_road([xodr.Line(150), xodr.Arc(0.01, length=150), xodr.Line(150)], 1)
    road.add_elevation(0, 0, 0.04, 0, 0)
    road.add_elevation(200, 8, -0.03, 0, 0)
    road.add_superelevation(0, 0.05, 0, 0, 0)
    return _of_roads(road)


def left_hand_traffic() -> xodr.OpenDrive:
    """A road on which the left is driven on."""
    road = xodr.create_road(xodr.Line(300), 1)
    road.rule = xodr.TrafficRule.LHT
    return _of_roads(road)


def road_with_objects_and_signs() -> xodr.OpenDrive:
    """Poles, a building and speed signs beside a road."""
    road = xodr.create_road(xodr.Line(300), 1)
    road.add_object(
        [
            xodr.Object(50, -6, Type=xodr.ObjectType.pole, id="1", name="pole", height=3, radius=0.2),
            xodr.Object(
                90, -15, Type=xodr.ObjectType.building, id="2", name="house", height=8, width=9, length=9
            ),
        ]
    )
    road.add_signal(xodr.Signal(40, -5, "DE", "274", "50", value=50, unit="km/h"))
    return _of_roads(road)


MAPS: tuple[Maker, ...] = (
    straight_road,
    bend_of_clothoids,
    road_of_polynomials,
    ring,
    lanes_that_merge_and_split,
    road_that_widens,
    crossing_of_three,
    crossing_of_four_with_two_lanes,
    crossing_with_lights,
    junction_of_unequal_roads,
    exit_and_entry_by_direct_junctions,
    lane_of_another_type,
    hill_with_superelevation,
    left_hand_traffic,
    road_with_objects_and_signs,
)


def write(make: Maker, path: Path) -> None:
    """Write a map to a file."""
    make().write_xml(str(path))


def _crossing(arms: int, lanes: int, lights: bool = False) -> xodr.OpenDrive:
    roads = [xodr.create_road(xodr.Line(120), number, lanes, lanes) for number in range(1, arms + 1)]
    junction = xodr.CommonJunctionCreator(100, "crossing")
    for number, road in enumerate(roads):
        junction.add_incoming_road_circular_geometry(road, 20, number * 2 * math.pi / arms, "successor")
        if lights:
            light = xodr.Signal(118, -5, "OpenDRIVE", "1000001", dynamic=xodr.Dynamic.yes)
            road.add_signal(light)
    for first in range(1, arms + 1):
        for second in range(first + 1, arms + 1):
            junction.add_connection(first, second)
    return _of_roads(*roads, junction=junction)


def _of_roads(
    *roads: xodr.Road,
    junction: xodr.CommonJunctionCreator | xodr.DirectJunctionCreator | None = None,
    second: xodr.DirectJunctionCreator | None = None,
) -> xodr.OpenDrive:
    content = xodr.OpenDrive("map")
    for road in roads:
        content.add_road(road)
    for creator in (junction, second):
        if creator is not None:
            content.add_junction_creator(creator)
    content.adjust_roads_and_lanes()
    return content
