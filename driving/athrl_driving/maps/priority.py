"""Which vehicle goes first: turns, roundabouts, ramps and priorities of movements through junctions."""

import math
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.conflicts import Relations
from athrl_driving.maps.lane_graph import TURN_LEFT, TURN_RIGHT, TURN_STRAIGHT
from athrl_driving.maps.opendrive.carriageways import LaneSegment
from athrl_driving.maps.opendrive.model import OpenDrive
from athrl_driving.maps.reachability import components
from athrl_driving.maps.standing_segments import Movement

STRAIGHT_WITHIN = math.radians(35.0)
"""A movement that turns by less goes straight on."""

_RAMP_WITHIN = math.radians(45.0)
_RING_RADIUS = 80.0
_RING_STRAIGHT = 5.0
"""Metres: longer straight segments are not part of a roundabout."""
_SLOWER = 0.9
"""A road with less than this share of another road's limit is the minor one."""


def turned(movement: Movement) -> float:
    """Return by how much a movement turns (rad, positive to the driver's right)."""
    return sum(segment.curvature * segment.length for segment in movement.segments)


def turn_of(movement: Movement) -> int:
    """Return TURN_LEFT, TURN_STRAIGHT or TURN_RIGHT."""
    angle = turned(movement)
    if abs(angle) <= STRAIGHT_WITHIN:
        return TURN_STRAIGHT
    return TURN_RIGHT if angle > 0.0 else TURN_LEFT


def ring_segments(segments: list[LaneSegment]) -> set[LaneSegment]:
    """Return the segments of roundabouts: closed loops of lanes that curve away from the traffic's side."""
    number = {segment: place for place, segment in enumerate(segments)}
    candidates = [_may_be_ring(segment) for segment in segments]
    edges = [
        [number[after] for after in segment.successors if after in number and candidates[number[after]]]
        if candidates[place]
        else []
        for place, segment in enumerate(segments)
    ]
    component = components(edges)
    members: dict[int, list[LaneSegment]] = defaultdict(list)
    for place, segment in enumerate(segments):
        members[component[place]].append(segment)
    return {
        segment
        for loop in members.values()
        if len(loop) > 1 and any(other.curvature != 0.0 for other in loop)
        for segment in loop
    }


def _may_be_ring(segment: LaneSegment) -> bool:
    if segment.curvature == 0.0 or segment.length < 0.1:
        return segment.length <= _RING_STRAIGHT
    # Headings grow clockwise: where traffic keeps to the right, a roundabout turns to the left.
    to_inside = segment.curvature if segment.carriageway.road.left_hand_traffic else -segment.curvature
    return to_inside >= 1.0 / _RING_RADIUS


def yielding_movements(
    content: OpenDrive, movements: list[Movement], relations: Relations, ring: set[LaneSegment]
) -> NDArray[np.bool_]:
    """Return which movements yield [M]: entries of roundabouts, merging ramps, and as the file says."""
    yields = np.zeros(len(movements), dtype=np.bool_)
    for place, movement in enumerate(movements):
        enters = movement.exit in ring or any(segment in ring for segment in movement.segments)
        yields[place] = enters and movement.origin not in ring
    lower = {
        (junction.id, high, low)
        for junction in content.junctions.values()
        for high, low in junction.priorities
    }
    merging = {segment for segment, origins in _origins_by_exit(movements).items() if len(origins) > 1}
    for first, second in relations.conflicts.tolist():
        movement, other = movements[first], movements[second]
        if (lower and _is_low(lower, movement, other)) or (
            movement.exit is other.exit and movement.exit in merging and _is_ramp(movement, other)
        ):
            yields[first] = True
    return yields


def _origins_by_exit(movements: list[Movement]) -> dict[LaneSegment, set[LaneSegment]]:
    result: dict[LaneSegment, set[LaneSegment]] = defaultdict(set)
    for movement in movements:
        result[movement.exit].add(movement.origin)
    return result


def _is_low(lower: set[tuple[str, str, str]], movement: Movement, other: Movement) -> bool:
    """Tell whether the file gives `other` the right of way; its pairs name incoming or connecting roads."""
    roads = {
        movement.origin.carriageway.road.id,
        *(segment.carriageway.road.id for segment in movement.segments),
    }
    high = {other.origin.carriageway.road.id, *(segment.carriageway.road.id for segment in other.segments)}
    return any((junction, a, b) in lower for junction in movement.junctions for a in high for b in roads)


def _is_ramp(movement: Movement, main: Movement) -> bool:
    """Tell whether `movement` merges at a small angle into the lane on which `main` continues."""
    if movement.origin.carriageway.road is main.origin.carriageway.road:
        return False
    angles = (_angle(movement), _angle(main))
    if max(angles) > _RAMP_WITHIN:
        return False
    return _rank(movement) < _rank(main)


def _angle(movement: Movement) -> float:
    """Return the angle (rad) between the road that a movement comes from and the one that it leads to."""
    before = movement.origin.heading + movement.origin.curvature * movement.origin.length
    return abs((movement.exit.heading - before + math.pi) % (2.0 * math.pi) - math.pi)


def _rank(movement: Movement) -> tuple[float, int, float, str]:
    """Return a rank by which the main road is greater: faster, wider, straighter.

    Ties are broken by name, so that two movements never both yield.
    """
    carriageway = movement.origin.carriageway
    return movement.origin.limit, len(carriageway.lanes), -abs(turned(movement)), carriageway.road.id


def _lane_count(movement: Movement) -> int:
    """Return the number of lanes at the stop line of the road that a movement comes from."""
    return len(movement.origin.carriageway.lanes)


def priorities(
    movements: list[Movement], turns: NDArray[np.int64], yields: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return the order of the movements [M]: lower numbers first.

    On the main road 0 straight on and to the side of the traffic, 1 across the oncoming traffic; 2 and 3 the
    same from a minor road; 4 movements that yield. A road is minor where it is slower than another of its
    junction, or narrower than another that is not slower, or meets a road that goes straight through a
    junction of three arms.
    """
    by_junction: dict[str, list[int]] = defaultdict(list)
    for place, movement in enumerate(movements):
        for junction in movement.junctions or [""]:
            by_junction[junction].append(place)
    minor = np.zeros(len(movements), dtype=np.bool_)
    for places in by_junction.values():
        main_speed = max(movements[place].origin.limit for place in places)
        widths = [(movements[place].origin.limit, _lane_count(movements[place])) for place in places]
        origins = {movements[place].origin.carriageway.road for place in places}
        through_roads = {
            movements[place].origin.carriageway.road for place in places if turns[place] == TURN_STRAIGHT
        }
        through = len(through_roads) >= 2 and len(origins) == 3
        for place in places:
            origin = movements[place].origin
            main_lanes = max(lanes for limit, lanes in widths if limit >= _SLOWER * origin.limit)
            minor[place] |= origin.limit < _SLOWER * main_speed
            minor[place] |= _lane_count(movements[place]) < main_lanes
            minor[place] |= through and origin.carriageway.road not in through_roads
    across = np.array(
        [
            turn == (TURN_RIGHT if movement.origin.carriageway.road.left_hand_traffic else TURN_LEFT)
            for movement, turn in zip(movements, turns.tolist(), strict=True)
        ],
        dtype=np.bool_,
    )
    result = 2 * minor.astype(np.int64) + across
    result[yields] = 4
    return result
