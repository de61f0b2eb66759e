"""Lanes that go on across a joint of two sections or roads although the file does not link them."""

import math
from collections import defaultdict
from collections.abc import Iterator

from athrl_driving.maps.opendrive.bounds import STEP
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.opendrive.model import OpenDrive, Road

FOUND = "lanes that meet where their roads or sections do, without a link of lanes, were linked"

_NEAR = 0.1
"""Metres between the end of a lane and the start of the one that it leads to."""

_STRAIGHT = math.radians(5.0)

Cells = dict[tuple[int, int], list[LaneSegment]]


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
            starts[_cell(segment.x, segment.y)].append(segment)
    for segment in segments:
        if segment.successors or _links_lanes(segment, at_end=True):
            continue
        meeting = [other for other in _starting_at_end(segment, starts) if _are_linked(segment, other)]
        if not meeting:
            continue
        after = min(meeting, key=lambda other: _distance(segment, other))
        starts[_cell(after.x, after.y)].remove(after)
        segment.successors.append(after)
        content.note(FOUND, segment.carriageway.road.id, segment.lane.id, segment.lane.line)


def _links_lanes(segment: LaneSegment, at_end: bool) -> bool:
    """Tell whether a lane of any type is linked where a segment ends or starts."""
    carriageway, (section, _) = segment.carriageway, segment.keys[-1 if at_end else 0]
    onwards = carriageway.forward == at_end
    return any(
        lane.successors if onwards else lane.predecessors
        for lane in carriageway.road.sections[section].lanes.values()
    )


def _cell(x: float, y: float) -> tuple[int, int]:
    return math.floor(x / _NEAR), math.floor(y / _NEAR)


def _starting_at_end(segment: LaneSegment, starts: Cells) -> Iterator[LaneSegment]:
    """Yield the lanes that begin where a segment ends, in its direction and at its height."""
    x, y, heading = segment.at(segment.length)
    column, row = _cell(x, y)
    for cell in ((column + i, row + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
        for other in starts.get(cell, []):
            turn = (other.heading - heading + math.pi) % (2.0 * math.pi) - math.pi
            rise = abs(other.elevation - segment.end_elevation)
            if _distance(segment, other) <= _NEAR and abs(turn) <= _STRAIGHT and rise <= STEP:
                yield other


def _distance(segment: LaneSegment, other: LaneSegment) -> float:
    x, y, _ = segment.at(segment.length)
    return math.hypot(other.x - x, other.y - y)


def _are_linked(segment: LaneSegment, other: LaneSegment) -> bool:
    """Tell whether two segments are of one road, or of two of which one names the other."""
    road, following = segment.carriageway.road, other.carriageway.road
    return road is following or _names(road, following) or _names(following, road)


def _names(road: Road, other: Road) -> bool:
    return any(
        link is not None and not link.is_junction and link.id == other.id
        for link in (road.predecessor, road.successor)
    )
