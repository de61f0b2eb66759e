"""Which lane leads to which: within a road, from road to road, and into junctions."""

import itertools
import logging
import math
from collections.abc import Iterable

from athrl_driving.maps.opendrive.model import Connection, JunctionRecord, MapError, OpenDrive, Road
from athrl_driving.maps.opendrive.strips import LanePiece, Strip

LINK_GAP = 0.01
"""Metres: the greatest jump from a lane's end to the start of the lane that follows."""

_log = logging.getLogger(__name__)

Ends = dict[tuple[str, str, int], tuple[LanePiece, bool]]
"""(road, "start" or "end", lane id) -> the lane's piece there, and whether vehicles leave the road there."""


def link_within(content: OpenDrive, road: Road, strips: list[Strip]) -> None:
    """Link the pieces of each lane along a road, and check that the lanes that are linked exist."""
    _check_lanes(content, road)
    for first, second in itertools.pairwise(strips):
        touching = first.end == second.start if first.forward else second.end == first.start
        if first.forward != second.forward or not touching:
            continue
        for piece in first.lanes:
            piece.successors = [other for other in second.lanes if _continues_in(road, piece, other)]


def _continues_in(road: Road, piece: LanePiece, other: LanePiece) -> bool:
    (section, lane), (next_section, next_lane) = piece.keys[-1], other.keys[0]
    if section == next_section:
        return lane == next_lane
    before, after = (piece, other) if section < next_section else (other, piece)
    lower, upper = before.lane, after.lane
    return upper.id in lower.successors or lower.id in upper.predecessors


def _check_lanes(content: OpenDrive, road: Road) -> None:
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
                        where = f"the section at s = {sections[other].s:.2f} m"
                        message = f"it is linked to lane {target} of {where}, which has no such lane"
                        raise content.error(road.id, lane.id, lane.line, message)


def road_ends(strips: Iterable[Strip]) -> Ends:
    """Return the pieces that reach the ends of their roads."""
    ends: Ends = {}
    for strip in strips:
        road = strip.road
        if strip.start <= 1e-6:
            for piece in strip.lanes:
                key = piece.keys[0 if strip.forward else -1]
                ends[road.id, "start", key[1]] = (piece, not strip.forward)
        if strip.end >= road.sections[-1].end - 1e-6:
            for piece in strip.lanes:
                key = piece.keys[-1 if strip.forward else 0]
                ends[road.id, "end", key[1]] = (piece, strip.forward)
    return ends


def link_roads(content: OpenDrive, ends: Ends) -> None:
    """Link the lanes of different roads, as the roads' links and the junctions' connections say."""
    for road in content.roads.values():
        for end, link in (("start", road.predecessor), ("end", road.successor)):
            if link is None or link.is_junction:
                continue
            if link.id not in content.roads:
                raise content.error(
                    road.id, None, link.line, f"it is linked to road {link.id}, which is not there"
                )
            section = road.sections[0 if end == "start" else -1]
            for lane in section.lanes.values():
                targets = lane.predecessors if end == "start" else lane.successors
                for target in targets if lane.drives else ():
                    place = (road.id, end, lane.id)
                    _link(content, ends, place, (link.id, link.contact, target), lane.line)
    for junction in content.junctions.values():
        for connection in junction.connections:
            _link_connection(content, ends, junction, connection)


def _link_connection(
    content: OpenDrive, ends: Ends, junction: JunctionRecord, connection: Connection
) -> None:
    for road in (connection.incoming, connection.connecting):
        if road not in content.roads:
            message = f"junction {junction.id}, line {connection.line}: there is no road {road}"
            raise MapError(f"{content.name}: {message}")
    contact = _incoming_end(content, junction, connection)
    for origin, target, line in connection.lane_links:
        _link(
            content,
            ends,
            (connection.incoming, contact, origin),
            (connection.connecting, connection.contact, target),
            line,
        )


def _incoming_end(content: OpenDrive, junction: JunctionRecord, connection: Connection) -> str:
    """Return the end of the incoming road that touches the connecting road."""
    connecting = content.roads[connection.connecting]
    link = connecting.predecessor if connection.contact == "start" else connecting.successor
    if link is not None and not link.is_junction and link.id == connection.incoming:
        return link.contact
    incoming = content.roads[connection.incoming]
    successor = incoming.successor
    return "end" if successor and successor.is_junction and successor.id == junction.id else "start"


def _link(
    content: OpenDrive, ends: Ends, first: tuple[str, str, int], second: tuple[str, str, int], line: int
) -> None:
    """Link two lanes at the ends of their roads in the direction in which vehicles drive."""
    for road, end, lane in (first, second):
        if lane not in content.roads[road].sections[0 if end == "start" else -1].lanes:
            other = second if (road, end, lane) == first else first
            message = (
                f"it is linked to lane {other[2]} of road {other[0]}, but has no lane {lane} at its {end}"
            )
            raise content.error(road, lane, line, message)
    if first not in ends or second not in ends:
        return
    (piece, leaves), (other_piece, other_leaves) = ends[first], ends[second]
    if leaves == other_leaves:
        _log.info(
            "%s: line %d: lane %d of road %s and lane %d of road %s meet head on",
            content.name,
            line,
            first[2],
            first[0],
            second[2],
            second[0],
        )
        return
    before, after = (piece, other_piece) if leaves else (other_piece, piece)
    if any(after is known for known in before.successors):
        return
    x, y, _ = before.at(before.length)
    gap = math.hypot(x - after.x, y - after.y)
    if gap > LINK_GAP:
        target = f"lane {second[2]} of road {second[0]}"
        message = f"it ends {gap:.3f} m from {target}, which it is linked to; {LINK_GAP} m are allowed"
        raise content.error(first[0], first[2], line, message)
    before.successors.append(after)
