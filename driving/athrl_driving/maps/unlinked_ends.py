"""Lanes that end exactly where another begins, though no link says so: told, not mended.

Maps that people write by hand often lack a link. Whether vehicles should drive on there cannot be known - it
may be a barrier -, but whoever wonders why they do not wants to be told.
"""

import math

from athrl_driving.maps.findings import Findings
from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.maps.opendrive.carriageways import LaneSegment
from athrl_driving.maps.standing_segments import predecessors_of

FOUND = "a lane ends where another begins, but no link says that it leads there: nobody drives on"

_NEAR = 0.3
"""Metres between end and beginning, up to which linked lanes are bridged too."""

_TURN = math.radians(10.0)

Point = tuple[float, float, float]


def note_unlinked_ends(findings: Findings, segments: list[LaneSegment]) -> None:
    """Note each lane without a successor whose end is the beginning of one without a predecessor."""
    led_to = predecessors_of(segments)
    beginnings: dict[tuple[int, int], list[LaneSegment]] = {}
    for segment in segments:
        if not led_to[segment]:
            beginnings.setdefault(_cell(segment.x, segment.y), []).append(segment)
    for segment in segments:
        if segment.successors:
            continue
        x, y, heading = segment.at(segment.length)
        column, row = _cell(x, y)
        near = [(column + i, row + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        for other in (other for cell in near for other in beginnings.get(cell, ())):
            if other is not segment and _meets((x, y, heading), segment.end_elevation, other):
                findings.add(FOUND, f"{_place(segment)}, and {_place(other)}", allowed=True)


def _cell(x: float, y: float) -> tuple[int, int]:
    return math.floor(x / _NEAR), math.floor(y / _NEAR)


def _meets(end: Point, elevation: float, other: LaneSegment) -> bool:
    x, y, heading = end
    return (
        math.hypot(other.x - x, other.y - y) <= _NEAR
        and abs(math.remainder(other.heading - heading, math.tau)) <= _TURN
        and abs(other.elevation - elevation) < ROAD_LEVEL_HEIGHT
    )


def _place(segment: LaneSegment) -> str:
    return f"road {segment.carriageway.road.id}, lane {segment.lane.id}"
