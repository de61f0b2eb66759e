"""Bridges small gaps between lanes that are linked.

Where a lane ends beside the start of the lane that follows, the longer of the two is bent: its one end is
moved by the gap and its other end stays, so a vehicle meets no jump, and a kink of a quarter of a radian at
most. An end that further lanes are linked to is not moved. Where neither lane can be bent, or both are too
short for the gap, the jump stays, and a vehicle is set from one lane to the other.
"""

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np

from athrl_driving.maps.levels import VEHICLE_LEVEL_HEIGHT
from athrl_driving.maps.opendrive.bounds import GAP, LARGEST_CORNER, LARGEST_GAP, LARGEST_STEP, SHARE_OF_GAP
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.opendrive.fitting import arc_through
from athrl_driving.maps.opendrive.model import OpenDrive

_Points = list[tuple[float, float]]


def close_gaps(content: OpenDrive, carriageways: Iterable[Carriageway]) -> None:
    """Let lanes that are linked meet.

    Raises `MapError` where they lie too far apart or on two levels, or where a lane turns at a corner.
    """
    segments = [segment for carriageway in carriageways for segment in carriageway.lanes]
    arrivals = Counter(after for segment in segments for after in segment.successors)
    for segment in segments:
        x, y, heading = segment.at(segment.length)
        for after in segment.successors:
            _check_height(content, segment, after)
            _check_heading(content, segment, after, heading)
            gap = math.hypot(after.x - x, after.y - y)
            if gap > GAP:
                _note_or_refuse(content, segment, after, gap)
                _bridge(segment, after, gap, arrivals[after] == 1)


def _note_or_refuse(content: OpenDrive, segment: LaneSegment, after: LaneSegment, gap: float) -> None:
    road, lane = segment.carriageway.road.id, segment.lane
    most = LARGEST_GAP
    if _goes_on(segment.carriageway, after.carriageway):
        # The road has no gap there: a width or an offset steps, or the reference line turns at a corner.
        most = max(most, min(segment.width, after.width))
    if round(gap, 3) > most:
        message = (
            f"it ends {gap:.3f} m from {_named(after)}, which it is linked to; at most {most:.2f} m may be"
        )
        raise content.error(road, lane.id, lane.line, message)
    content.note("a gap between linked lanes was bridged", road, lane.id, lane.line, gap)


def _check_height(content: OpenDrive, segment: LaneSegment, after: LaneSegment) -> None:
    """Note a step in height between two roads. Raises `MapError` where it leads to another level.

    Less is no fault for certain: superelevation, which is passed over, may lie between.
    """
    step = abs(after.elevation - segment.end_elevation)
    if step <= LARGEST_STEP or segment.carriageway.road is after.carriageway.road:
        return
    road, lane = segment.carriageway.road.id, segment.lane
    if step > VEHICLE_LEVEL_HEIGHT:
        place = f"{step:.3f} m above or below {_named(after)}, which it is linked to"
        message = f"it ends {place}; at most {VEHICLE_LEVEL_HEIGHT} m may be"
        raise content.error(road, lane.id, lane.line, message)
    content.note("a step in height between linked lanes was driven over", road, lane.id, lane.line, step)


def _check_heading(content: OpenDrive, segment: LaneSegment, after: LaneSegment, heading: float) -> None:
    """Raise `MapError` where a lane turns by a large angle at once."""
    corner = abs(math.remainder(after.heading - heading, math.tau))
    if corner > LARGEST_CORNER:
        turn = f"it turns by {math.degrees(corner):.0f} degrees at once into {_named(after)}"
        message = f"{turn}, which it is linked to; at most {math.degrees(LARGEST_CORNER):.0f} may be"
        raise content.error(segment.carriageway.road.id, segment.lane.id, segment.lane.line, message)


def _named(segment: LaneSegment) -> str:
    return f"lane {segment.lane.id} of road {segment.carriageway.road.id}"


def _goes_on(before: Carriageway, after: Carriageway) -> bool:
    """Tell whether one carriageway is continued by another of the same road."""
    if before.road is not after.road or before.forward != after.forward:
        return False
    return before.end == after.start if before.forward else before.start == after.end


def _bridge(segment: LaneSegment, after: LaneSegment, gap: float, only_arrival: bool) -> None:
    """Bend the longer of two lanes of which no other lane needs the end."""
    free = [segment] if len(segment.successors) == 1 else []
    free += [after] if only_arrival else []
    longest = max(free, key=_stays_least, default=None)
    if longest is None or gap > SHARE_OF_GAP * longest.length:
        return
    start, middle, end = (longest.at(share * longest.length)[:2] for share in (0.0, 0.5, 1.0))
    if longest is segment:
        end, moved = (after.x, after.y), end
        middle = _shifted(middle, moved, end)
    else:
        start, moved = segment.at(segment.length)[:2], start
        middle = _shifted(middle, moved, start)
    _lead_along(longest, [start, middle, end])


def _stays_least(segment: LaneSegment) -> tuple[float, str, float]:
    """Return by what is chosen who is bent: the same side of a joint for both directions of a road.

    Otherwise the lanes of two directions could be led onto each other.
    """
    carriageway = segment.carriageway
    return round(carriageway.end - carriageway.start, 3), carriageway.road.id, -carriageway.start


def _shifted(
    point: tuple[float, float], moved: tuple[float, float], to: tuple[float, float]
) -> tuple[float, float]:
    """Return a point, moved by half of what another is moved by."""
    return point[0] + 0.5 * (to[0] - moved[0]), point[1] + 0.5 * (to[1] - moved[1])


def _lead_along(segment: LaneSegment, points: _Points) -> None:
    """Let a segment be the line or arc through three points."""
    x, y = np.array(points).T
    fit = arc_through(x, y)
    if fit is not None:
        segment.x, segment.y, segment.heading = fit.x, fit.y, fit.heading
        segment.curvature, segment.length = fit.curvature, fit.length
