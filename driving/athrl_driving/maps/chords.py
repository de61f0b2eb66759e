"""Lanes as short straight pieces, by which is found where they lie on or across each other."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.maps.opendrive.carriageways import LaneSegment

CHORD = 4.0
"""Metres of lane, at most, that are taken as straight."""

_APART = 25.0
"""Metres to drive from one place to another, below which they are one way and not in each other's."""

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Pair = tuple[LaneSegment, LaneSegment]
Places = tuple[float, float]
"""Where on each of two segments, m."""


class Chords(NamedTuple):
    """Segments as polylines: N chords from one point to the next."""

    segment: Integers
    """[N] its number."""
    s: Floats
    """[N, 2] m along the segment, of both ends."""
    points: Floats
    """[N, 2, 2] of both ends: x and y, m."""


def chords_of(segments: list[LaneSegment]) -> Chords:
    """Return the chords of segments, in their order."""
    numbers, s, points = [], [], []
    for number, segment in enumerate(segments):
        stations = np.linspace(0.0, segment.length, max(1, math.ceil(segment.length / CHORD)) + 1)
        numbers.append(np.full(len(stations) - 1, number))
        s.append(np.stack([stations[:-1], stations[1:]], axis=1))
        half = 0.5 * segment.curvature * stations
        chord, direction = stations * np.sinc(half / np.pi), segment.heading + half
        x, y = segment.x + chord * np.cos(direction), segment.y + chord * np.sin(direction)
        places = np.stack([x, y], axis=1)
        points.append(np.stack([places[:-1], places[1:]], axis=1))
    return Chords(np.concatenate(numbers), np.concatenate(s), np.concatenate(points))


def are_on_one_level(pair: Pair, places: Places) -> bool:
    """Tell whether vehicles at two places that lie over each other are in each other's way."""
    low, high = sorted(
        segment.elevation + (segment.end_elevation - segment.elevation) * s / segment.length
        for segment, s in zip(pair, places, strict=True)
    )
    return high - low <= ROAD_LEVEL_HEIGHT


def are_one_way(pair: Pair, places: Places) -> bool:
    """Tell whether a short way leads from one place to the other: linked ends may not meet exactly."""
    (first, second), (here, there) = pair, places
    return _leads(first, here, second, there) or _leads(second, there, first, here)


def _leads(origin: LaneSegment, s: float, target: LaneSegment, until: float) -> bool:
    work, seen = [(origin, origin.length - s)], {origin}
    while work:
        segment, length = work.pop()
        for after in segment.successors:
            if after is target and length + until < _APART:
                return True
            if after not in seen and length + after.length < _APART:
                seen.add(after)
                work.append((after, length + after.length))
    return False
