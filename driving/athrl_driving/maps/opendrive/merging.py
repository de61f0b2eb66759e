"""Joins carriageways that are one: sections often begin where nothing changes for a vehicle."""

import math

from athrl_driving.maps.opendrive.carriageways import ELEVATION_TOLERANCE, Carriageway, LaneSegment
from athrl_driving.maps.opendrive.cross_section import climbs_evenly

SHORTEST = 0.03
"""Metres: shorter carriageways are removed; their length is added to a neighbour."""

_JOINT = 0.001
_SAME_CURVATURE = 1e-6


def merged(carriageways: list[Carriageway]) -> list[Carriageway]:
    """Return the carriageways of one road; those that continue on the same line or arc are joined."""
    result: list[Carriageway] = []
    for carriageway in carriageways:
        if not result or not _join(result[-1], carriageway):
            result.append(carriageway)
    return result


def _join(first: Carriageway, second: Carriageway) -> bool:
    """Add `second` to `first` where that is possible, and tell whether it was."""
    if first.forward != second.forward or len(first.lanes) != len(second.lanes):
        return False
    pairs = list(zip(first.lanes, second.lanes, strict=True))
    if any(len(a.successors) != 1 or a.successors[0] is not b for a, b in pairs):
        return False
    short_first = first.end - first.start < SHORTEST
    short_second = second.end - second.start < SHORTEST
    if not (short_first or short_second):
        start, end = min(first.start, second.start), max(first.end, second.end)
        if not all(_continues(a, b) for a, b in pairs):
            return False
        if not climbs_evenly(first.road, start, end, ELEVATION_TOLERANCE):
            return False
    for a, b in pairs:
        if short_first and not short_second:
            _start_from(a, b)
        a.keys += [key for key in b.keys if key not in a.keys]
        a.length += b.length
        a.end_elevation = b.end_elevation
        a.successors = b.successors
    first.start, first.end = min(first.start, second.start), max(first.end, second.end)
    return True


def _start_from(short: LaneSegment, segment: LaneSegment) -> None:
    """Give a very short segment the line or arc of the one that follows."""
    x, y, heading = segment.at(-short.length)
    short.x, short.y, short.heading, short.curvature = x, y, heading, segment.curvature
    short.width, short.limit, short.lane = segment.width, segment.limit, segment.lane
    short.may_left, short.may_right = segment.may_left, segment.may_right


def _continues(a: LaneSegment, b: LaneSegment) -> bool:
    """Tell whether one line or arc, and one set of properties, stands for both."""
    if (a.may_left, a.may_right) != (b.may_left, b.may_right) or a.limit != b.limit:
        return False
    if abs(a.width - b.width) > 0.01 or abs(a.curvature - b.curvature) > _SAME_CURVATURE:
        return False
    if abs(a.curvature) * (a.length + b.length) > 2.0:
        return False
    starts, ends = a.at(a.length), a.at(a.length + b.length)
    b_end = b.at(b.length)
    return (
        math.hypot(starts[0] - b.x, starts[1] - b.y) < _JOINT
        and math.hypot(ends[0] - b_end[0], ends[1] - b_end[1]) < _JOINT
        and math.cos(starts[2] - b.heading) > 0.99999
    )
