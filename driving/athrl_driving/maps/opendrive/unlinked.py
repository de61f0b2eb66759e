"""Lanes that meet end to end although the file does not link them: linked, or told of."""

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator

from athrl_driving.maps.opendrive.bounds import STEP
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.opendrive.model import OpenDrive

FOUND = "lanes that meet where their roads or sections do, without a link of lanes, were linked"

NOT_LINKED = "a lane ends where another begins, but no link says that it leads there: nobody drives on"

_NEAR = 0.1
"""Metres between the end of a lane and the start of the one that it leads to."""

_STRAIGHT = math.radians(5.0)

_MOST_ROADS = 16
"""Roads that begin at one place, of which lanes are looked at for missing links."""

Cell = tuple[int, int]
Cells = dict[tuple[str, Cell], list[LaneSegment]]
"""Segments by the road that they are of, and the cell in which they start."""


def link_lanes_that_meet(content: OpenDrive, carriageways: list[Carriageway]) -> None:
    """Link lanes that nothing follows to those that nothing leads to, where they meet end to end.

    Their roads must be linked to each other, or be one road: some programs write no more than that. Where
    any lane is linked at the joint, the file means that the others end.
    """
    segments = [segment for carriageway in carriageways for segment in carriageway.lanes]
    reached = {after for segment in segments for after in segment.successors}
    starts: Cells = defaultdict(list)
    for segment in segments:
        if segment not in reached and not _links_lanes(segment, at_end=False):
            starts[_place(segment)].append(segment)
    linked = _linked_roads(content)
    for segment in segments:
        if segment.successors or _links_lanes(segment, at_end=True):
            continue
        meeting = list(_starting_at_end(segment, linked[segment.carriageway.road.id], starts))
        if not meeting:
            continue
        after = min(meeting, key=lambda other: _distance(segment, other))
        starts[_place(after)].remove(after)
        segment.successors.append(after)
        content.note(FOUND, segment.carriageway.road.id, segment.lane.id, segment.lane.line)


def note_roads_that_meet(content: OpenDrive, carriageways: list[Carriageway]) -> None:
    """Note lanes that end where one of another road begins, if neither road has a link there.

    There may be a barrier, but whoever forgot a link wonders why nobody drives on. Of many roads that begin
    at one place the first are looked at.
    """
    segments = [segment for carriageway in carriageways for segment in carriageway.lanes]
    reached = {after for segment in segments for after in segment.successors}
    starts: Cells = defaultdict(list)
    roads: dict[Cell, dict[str, None]] = defaultdict(dict)
    for segment in segments:
        road, cell = _place(segment)
        if (
            segment not in reached
            and not _links_road(segment, at_end=False)
            and len(roads[cell]) < _MOST_ROADS
        ):
            starts[road, cell].append(segment)
            roads[cell][road] = None
    for segment in segments:
        if segment.successors or _links_road(segment, at_end=True):
            continue
        x, y, _ = segment.at(segment.length)
        near = itertools.chain.from_iterable(roads.get(cell, ()) for cell in _cells_around(x, y))
        for other in itertools.islice(_starting_at_end(segment, dict.fromkeys(near), starts), 1):
            first, second = (
                f"road {each.carriageway.road.id}, lane {each.lane.id}" for each in (segment, other)
            )
            content.findings.add(NOT_LINKED, f"{first}, and {second}", allowed=True)


def _links_road(segment: LaneSegment, at_end: bool) -> bool:
    """Tell whether the road of a segment has a link where the segment ends or starts."""
    road = segment.carriageway.road
    return (road.successor if segment.carriageway.forward == at_end else road.predecessor) is not None


def _links_lanes(segment: LaneSegment, at_end: bool) -> bool:
    """Tell whether a lane of any type is linked where a segment ends or starts."""
    carriageway, (section, _) = segment.carriageway, segment.keys[-1 if at_end else 0]
    onwards = carriageway.forward == at_end
    return any(
        lane.successors if onwards else lane.predecessors
        for lane in carriageway.road.sections[section].lanes.values()
    )


def _cell(x: float, y: float) -> Cell:
    return math.floor(x / _NEAR), math.floor(y / _NEAR)


def _cells_around(x: float, y: float) -> list[Cell]:
    column, row = _cell(x, y)
    return [(column + i, row + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]


def _place(segment: LaneSegment) -> tuple[str, Cell]:
    return segment.carriageway.road.id, _cell(segment.x, segment.y)


def _starting_at_end(segment: LaneSegment, roads: Iterable[str], starts: Cells) -> Iterator[LaneSegment]:
    """Yield the lanes of `roads` that begin where a segment ends, in its direction and at its height."""
    x, y, heading = segment.at(segment.length)
    for place in ((road, cell) for cell in _cells_around(x, y) for road in roads):
        for other in starts.get(place, []):
            turn = (other.heading - heading + math.pi) % (2.0 * math.pi) - math.pi
            rise = abs(other.elevation - segment.end_elevation)
            if _distance(segment, other) <= _NEAR and abs(turn) <= _STRAIGHT and rise <= STEP:
                yield other


def _distance(segment: LaneSegment, other: LaneSegment) -> float:
    x, y, _ = segment.at(segment.length)
    return math.hypot(other.x - x, other.y - y)


def _linked_roads(content: OpenDrive) -> dict[str, dict[str, None]]:
    """Return by road the road itself, those that it names and those that name it, in the file's order."""
    linked: dict[str, dict[str, None]] = {road: {road: None} for road in content.roads}
    for road in content.roads.values():
        for link in (road.predecessor, road.successor):
            if link is not None and not link.is_junction and link.id in linked:
                linked[road.id][link.id] = linked[link.id][road.id] = None
    return linked
