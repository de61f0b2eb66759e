"""Which lane leads to which: within a road, from road to road, and into junctions."""

import itertools
from collections.abc import Iterable

from athrl_driving.maps.opendrive.bounds import MOST_LANES_BESIDE, SAME_PLACE
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.opendrive.connections import NO_ROAD, Ends, LaneEnd, connected_lanes
from athrl_driving.maps.opendrive.model import OpenDrive, Road

_NO_LANE = "a link to a lane that is not there was passed over"
_NO_JUNCTION = "a link to a junction that is not in the file was passed over"


def link_within(content: OpenDrive, road: Road, carriageways: list[Carriageway]) -> None:
    """Link the segments of each lane along a road, and note links to lanes that do not exist."""
    _note_missing_lanes(content, road)
    for first, second in itertools.pairwise(carriageways):
        touching = first.end == second.start if first.forward else second.end == first.start
        if first.forward != second.forward or not touching:
            continue
        for segment in first.lanes:
            segment.successors = [other for other in second.lanes if _continues_in(road, segment, other)]


def _continues_in(road: Road, segment: LaneSegment, other: LaneSegment) -> bool:
    (section, lane), (next_section, next_lane) = segment.keys[-1], other.keys[0]
    if section == next_section:
        return lane == next_lane
    before, after = (segment, other) if section < next_section else (other, segment)
    lower, upper = before.lane, after.lane
    return upper.id in lower.successors or lower.id in upper.predecessors


def _note_missing_lanes(content: OpenDrive, road: Road) -> None:
    sections = road.sections
    for number, section in enumerate(sections):
        for lane in section.lanes.values():
            if not lane.drives:
                continue
            for ids, other in ((lane.predecessors, number - 1), (lane.successors, number + 1)):
                if not 0 <= other < len(sections):
                    continue
                for target in ids:
                    if target not in sections[other].lanes:
                        content.note(_NO_LANE, road.id, lane.id, lane.line)


def road_ends(carriageways: Iterable[Carriageway]) -> Ends:
    """Return the segments that reach the ends of their roads."""
    ends: Ends = {}
    for carriageway in carriageways:
        road = carriageway.road
        if carriageway.start <= SAME_PLACE:
            for segment in carriageway.lanes:
                key = segment.keys[0 if carriageway.forward else -1]
                ends[road.id, "start", key[1]] = (segment, not carriageway.forward)
        if carriageway.end >= road.sections[-1].end - SAME_PLACE:
            for segment in carriageway.lanes:
                key = segment.keys[-1 if carriageway.forward else 0]
                ends[road.id, "end", key[1]] = (segment, carriageway.forward)
    return ends


def link_roads(content: OpenDrive, ends: Ends) -> None:
    """Link the lanes of different roads, as the roads' links and the junctions' connections say."""
    for road in content.roads.values():
        for end, link in (("start", road.predecessor), ("end", road.successor)):
            if link is None:
                continue
            if link.is_junction:
                if link.id not in content.junctions:
                    content.note(_NO_JUNCTION, road.id, None, link.line)
                continue
            if link.id not in content.roads:
                content.note(NO_ROAD, road.id, None, link.line)
                continue
            section = road.sections[0 if end == "start" else -1]
            for lane in section.lanes.values():
                targets = lane.predecessors if end == "start" else lane.successors
                for target in targets if lane.drives else ():
                    place = (road.id, end, lane.id)
                    _link(content, ends, place, (link.id, link.contact, target), lane.line)
    for first, second, line in connected_lanes(content, ends):
        _link(content, ends, first, second, line)


def _link(content: OpenDrive, ends: Ends, first: LaneEnd, second: LaneEnd, line: int) -> None:
    """Link two lanes at the ends of their roads in the direction in which vehicles drive."""
    for road, end, lane in (first, second):
        if lane not in content.roads[road].sections[0 if end == "start" else -1].lanes:
            content.note(_NO_LANE, first[0], first[2], line)
            return
    if first not in ends or second not in ends:
        return
    (segment, leaves), (other_segment, other_leaves) = ends[first], ends[second]
    if leaves == other_leaves:
        place = f"line {line}: lane {first[2]} of road {first[0]} and lane {second[2]} of road {second[0]}"
        content.findings.add("lanes that meet head on were not linked", place)
        return
    before, after = (segment, other_segment) if leaves else (other_segment, segment)
    if any(after is known for known in before.successors):
        return
    if len(before.successors) >= MOST_LANES_BESIDE:
        raise content.error(first[0], first[2], line, f"a lane leads to more than {MOST_LANES_BESIDE} lanes")
    before.successors.append(after)
