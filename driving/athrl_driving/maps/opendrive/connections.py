"""Which lanes the connections of junctions link: those of common junctions and of direct ones."""

import math
from collections.abc import Iterator

from athrl_driving.maps.opendrive.carriageways import LaneSegment
from athrl_driving.maps.opendrive.model import Connection, JunctionRecord, OpenDrive, Road, RoadLink

NO_ROAD = "a link to a road that is not in the file was passed over"

LaneEnd = tuple[str, str, int]
"""(road, "start" or "end", lane id)."""

Ends = dict[LaneEnd, tuple[LaneSegment, bool]]
"""By lane's end: the segment there, and whether vehicles leave the road there."""


def connected_lanes(content: OpenDrive, ends: Ends) -> Iterator[tuple[LaneEnd, LaneEnd, int]]:
    """Yield the lanes' ends that the junctions link, and the line of the file that says so."""
    for junction in content.junctions.values():
        for connection in junction.connections:
            if {connection.incoming, connection.connecting} <= content.roads.keys():
                yield from _linked_by(content, ends, junction, connection)
            else:
                content.findings.add(NO_ROAD, f"junction {junction.id}, line {connection.line}")


def _linked_by(
    content: OpenDrive, ends: Ends, junction: JunctionRecord, connection: Connection
) -> Iterator[tuple[LaneEnd, LaneEnd, int]]:
    incoming, connecting = content.roads[connection.incoming], content.roads[connection.connecting]
    contact = connection.contact or _contact(junction, incoming, connecting)
    before = _incoming_end(ends, junction, connection, incoming, connecting, contact)
    links = connection.lane_links
    if links is None:
        links = _same_ids(ends, incoming, before, (connecting.id, contact), connection.line)
    for origin, target, line in links:
        yield (incoming.id, before, origin), (connecting.id, contact, target), line


def _same_ids(
    ends: Ends, incoming: Road, before: str, after: tuple[str, str], line: int
) -> tuple[tuple[int, int, int], ...]:
    """Return the links of a connection that names none: lanes with the same id on which traffic goes on."""
    section = incoming.sections[0 if before == "start" else -1]
    return tuple(
        (lane, lane, line)
        for lane in section.lanes
        if (here := (incoming.id, before, lane)) in ends
        and (there := (*after, lane)) in ends
        and ends[here][1] != ends[there][1]
    )


def _contact(junction: JunctionRecord, incoming: Road, connecting: Road) -> str:
    """Return the end of the connecting road that is linked to the incoming one, or to a direct junction."""
    to_road = [end for end, link in _links(connecting) if _leads_to(link, incoming)]
    return (to_road or _ends_at(connecting, junction) or ["start"])[0]


def _links(road: Road) -> Iterator[tuple[str, RoadLink]]:
    """Yield the ends of a road that are linked, and to what."""
    for end, link in (("start", road.predecessor), ("end", road.successor)):
        if link is not None:
            yield end, link


def _ends_at(road: Road, junction: JunctionRecord) -> list[str]:
    """Return the ends of a road that are linked to a junction."""
    return [end for end, link in _links(road) if link.is_junction and link.id == junction.id]


def _leads_to(link: RoadLink, road: Road) -> bool:
    return not link.is_junction and link.id == road.id


def _incoming_end(
    ends: Ends,
    junction: JunctionRecord,
    connection: Connection,
    incoming: Road,
    connecting: Road,
    contact: str,
) -> str:
    """Return the end of the incoming road that touches the connecting road.

    The connecting road's link says it, which it does not in a direct junction; else it is the end that is
    linked to the junction, and where both ends are, the nearer one.
    """
    link = connecting.predecessor if contact == "start" else connecting.successor
    if link is not None and _leads_to(link, incoming):
        return link.contact
    linked = _ends_at(incoming, junction)
    if len(linked) == 1:
        return linked[0]
    return min(("start", "end"), key=lambda end: _distance(ends, connection, end, contact))


def _distance(ends: Ends, connection: Connection, end: str, contact: str) -> float:
    """Return how far (m) the linked lanes are from each other, if the incoming road's `end` is meant."""
    distances = [
        math.dist(_point(ends[before]), _point(ends[after]))
        for origin, target, _ in connection.lane_links or ()
        if (before := (connection.incoming, end, origin)) in ends
        and (after := (connection.connecting, contact, target)) in ends
    ]
    return min(distances, default=math.inf)


def _point(lane_end: tuple[LaneSegment, bool]) -> tuple[float, float]:
    segment, leaves = lane_end
    x, y, _ = segment.at(segment.length if leaves else 0.0)
    return x, y
