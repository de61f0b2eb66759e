"""How far lanes that part or join lie over each other: so far their vehicles are in each other's way."""

import math
from collections.abc import Iterator

from athrl_driving.maps.opendrive.carriageways import LaneSegment

CLEARANCE = 3.0
"""Metres between two centre lines: a vehicle's width, what its corners sweep in a turn, and a margin."""

SHARE_OF_WIDTH = 0.43
"""Of two lanes' widths together: on narrow lanes vehicles keep a smaller distance than `CLEARANCE`."""

LONGEST_OVERLAP = 100.0
"""Metres that are looked at; the standard's default for the overlap of direct junctions."""

_SPACING = 1.0
_LAG = 10
"""Points by which the way to one place may be longer on one of the two lanes."""

Chain = list[LaneSegment]
"""Segments from the place where two lanes part, away from it; or from where they join, backwards."""


def chain_from(segment: LaneSegment, neighbours: dict[LaneSegment, list[LaneSegment]]) -> Chain:
    """Return the segments from one on along `neighbours`, as long as there is one way; twice the overlap."""
    chain, length = [segment], segment.length
    while length < 2.0 * LONGEST_OVERLAP:
        following = neighbours.get(chain[-1], [])
        if len(following) != 1 or following[0].junction not in ("", chain[0].junction):
            break
        if following[0] in chain:
            break
        chain.append(following[0])
        length += following[0].length
    return chain


def overlap(chain: Chain, other: Chain, forward: bool) -> float:
    """Return how many metres of a chain vehicles on the other one are in the way of.

    Both begin at one place and are driven away from it (`forward`) or towards it.
    """
    points, others = list(_points(chain, forward)), list(_points(other, forward))
    clear = min(CLEARANCE, SHARE_OF_WIDTH * (chain[0].width + other[0].width))
    for place, point in enumerate(points):
        near = others[max(place - _LAG, 0) : place + _LAG + 1]
        if all(math.dist(point, there) >= clear for there in near):
            return place * _SPACING
    return len(points) * _SPACING


def _points(chain: Chain, forward: bool) -> Iterator[tuple[float, float]]:
    """Yield a point every metre from the place where the lanes part or join."""
    count, passed = int(LONGEST_OVERLAP / _SPACING), 0.0
    place = 0
    for segment in chain:
        while place < count and place * _SPACING <= passed + segment.length:
            s = place * _SPACING - passed
            x, y, _ = segment.at(s if forward else segment.length - s)
            yield x, y
            place += 1
        passed += segment.length
