"""Who goes first: turns, roundabouts, ramps and priorities of the ways through junctions."""

import math
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.conflicts import Relations
from athrl_driving.maps.lane_graph import TURN_LEFT, TURN_RIGHT, TURN_STRAIGHT
from athrl_driving.maps.opendrive.model import OpenDrive
from athrl_driving.maps.opendrive.strips import LanePiece
from athrl_driving.maps.reachability import components
from athrl_driving.maps.stretches import Way

STRAIGHT_WITHIN = math.radians(35.0)
"""A way that turns by less leads straight on."""

_RAMP_WITHIN = math.radians(45.0)
_RING_RADIUS = 80.0
_RING_STRAIGHT = 5.0
"""Metres: longer straight pieces are no part of a roundabout."""
_SLOWER = 0.9
"""A road with less than this share of another one's limit is the minor one."""


def turned(way: Way) -> float:
    """Return by how much a way turns (rad, positive to the driver's right)."""
    return sum(piece.curvature * piece.length for piece in way.pieces)


def turn_of(way: Way) -> int:
    """Return TURN_LEFT, TURN_STRAIGHT or TURN_RIGHT."""
    angle = turned(way)
    if abs(angle) <= STRAIGHT_WITHIN:
        return TURN_STRAIGHT
    return TURN_RIGHT if angle > 0.0 else TURN_LEFT


def ring_pieces(pieces: list[LanePiece]) -> set[LanePiece]:
    """Return the pieces of roundabouts: closed loops of lanes that curve away from the traffic's side."""
    number = {piece: place for place, piece in enumerate(pieces)}
    candidates = [_may_be_ring(piece) for piece in pieces]
    edges = [
        [number[after] for after in piece.successors if after in number and candidates[number[after]]]
        if candidates[place]
        else []
        for place, piece in enumerate(pieces)
    ]
    component = components(edges)
    members: dict[int, list[LanePiece]] = defaultdict(list)
    for place, piece in enumerate(pieces):
        members[component[place]].append(piece)
    return {
        piece
        for loop in members.values()
        if len(loop) > 1 and any(other.curvature != 0.0 for other in loop)
        for piece in loop
    }


def _may_be_ring(piece: LanePiece) -> bool:
    if piece.curvature == 0.0 or piece.length < 0.1:
        return piece.length <= _RING_STRAIGHT
    # Headings grow clockwise: where traffic keeps to the right, a roundabout turns to the left.
    to_inside = piece.curvature if piece.strip.road.left_hand_traffic else -piece.curvature
    return to_inside >= 1.0 / _RING_RADIUS


def yielding_ways(
    content: OpenDrive, ways: list[Way], relations: Relations, ring: set[LanePiece]
) -> NDArray[np.bool_]:
    """Return which ways give way [M]: entries of roundabouts, merging ramps, and as the file says."""
    yields = np.zeros(len(ways), dtype=np.bool_)
    for place, way in enumerate(ways):
        enters = way.exit in ring or any(piece in ring for piece in way.pieces)
        yields[place] = enters and way.origin not in ring
    lower = {
        (junction.id, high, low)
        for junction in content.junctions.values()
        for high, low in junction.priorities
    }
    merging = {piece for piece, origins in _origins_by_exit(ways).items() if len(origins) > 1}
    for first, second in relations.conflicts.tolist():
        way, other = ways[first], ways[second]
        if (lower and _is_low(lower, way, other)) or (
            way.exit is other.exit and way.exit in merging and _is_ramp(way, other)
        ):
            yields[first] = True
    return yields


def _origins_by_exit(ways: list[Way]) -> dict[LanePiece, set[LanePiece]]:
    result: dict[LanePiece, set[LanePiece]] = defaultdict(set)
    for way in ways:
        result[way.exit].add(way.origin)
    return result


def _is_low(lower: set[tuple[str, str, str]], way: Way, other: Way) -> bool:
    """Tell whether the file gives `other` the right of way; its pairs name incoming or connecting roads."""
    roads = {way.origin.strip.road.id, *(piece.strip.road.id for piece in way.pieces)}
    high = {other.origin.strip.road.id, *(piece.strip.road.id for piece in other.pieces)}
    return any((junction, a, b) in lower for junction in way.junctions for a in high for b in roads)


def _is_ramp(way: Way, main: Way) -> bool:
    """Tell whether `way` merges at a small angle into the lane on which `main` goes on."""
    if way.origin.strip.road is main.origin.strip.road:
        return False
    angles = (_angle(way), _angle(main))
    if max(angles) > _RAMP_WITHIN:
        return False
    return _rank(way) < _rank(main)


def _angle(way: Way) -> float:
    """Return the angle (rad) between the road that a way comes from and the one that it leads to."""
    before = way.origin.heading + way.origin.curvature * way.origin.length
    return abs((way.exit.heading - before + math.pi) % (2.0 * math.pi) - math.pi)


def _rank(way: Way) -> tuple[float, int, float, str]:
    """The greater is the main road: faster, wider, straighter; then by name, so that two never both yield."""
    strip = way.origin.strip
    return way.origin.limit, len(strip.lanes), -abs(turned(way)), strip.road.id


def priorities(ways: list[Way], turns: NDArray[np.int64], yields: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the order of the ways [M]: lower numbers first.

    On the main road 0 straight on and to the side of the traffic, 1 across the oncoming traffic; 2 and 3 the
    same from a minor road; 4 whoever gives way. A road is minor where it is slower or narrower than
    another of its junction, or meets a road that goes straight through a junction of three arms.
    """
    by_junction: dict[str, list[int]] = defaultdict(list)
    for place, way in enumerate(ways):
        for junction in way.junctions or [""]:
            by_junction[junction].append(place)
    minor = np.zeros(len(ways), dtype=np.bool_)
    for places in by_junction.values():
        main_speed = max(ways[place].origin.limit for place in places)
        main_lanes = max(len(ways[place].origin.strip.lanes) for place in places)
        origins = {ways[place].origin.strip.road for place in places}
        goes_on = {ways[place].origin.strip.road for place in places if turns[place] == TURN_STRAIGHT}
        through = len(goes_on) >= 2 and len(origins) == 3
        for place in places:
            origin = ways[place].origin
            minor[place] |= origin.limit < _SLOWER * main_speed
            minor[place] |= origin.limit <= main_speed and len(origin.strip.lanes) < main_lanes
            minor[place] |= through and origin.strip.road not in goes_on
    across = np.array(
        [
            turn == (TURN_RIGHT if way.origin.strip.road.left_hand_traffic else TURN_LEFT)
            for way, turn in zip(ways, turns.tolist(), strict=True)
        ],
        dtype=np.bool_,
    )
    result = 2 * minor.astype(np.int64) + across
    result[yields] = 4
    return result
