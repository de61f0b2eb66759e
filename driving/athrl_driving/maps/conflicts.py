"""Which movements through junctions conflict with each other, from their geometry.

Two vehicles whose centre lines come closer than `CLEARANCE` cannot pass each other, unless one road is above
the other. Movements that start from the same lane do not conflict: their vehicles follow each other until the
movements have diverged. Movements that lead to the same lane do conflict. Everything is found from points
sampled along the segments and hashed into cells, so the time does not depend on how the junctions are joined.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.maps.near_pairs import near_pairs, refuse_many
from athrl_driving.maps.opendrive.bounds import MOST_CLOSE_MOVEMENTS, MOST_POINTS
from athrl_driving.maps.opendrive.carriageways import LaneSegment
from athrl_driving.maps.overlaps import CLEARANCE, SHARE_OF_WIDTH
from athrl_driving.maps.standing_segments import Movement

_SPACING = 0.5

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Relations:
    """Ordered pairs of movements, sorted by (first, second), with a distance in metres.

    For conflicts: how far along the second a vehicle's rear must be to be out of the way of the first. For
    siblings (the same origin): over which distance from the origin the two share the road.
    """

    conflicts: Integers
    """[C, 2]."""
    release: Floats
    """[C]."""
    siblings: Integers
    """[S, 2]."""
    shared: Floats
    """[S]."""


@dataclass(frozen=True, slots=True)
class _Points:
    """Points along segments; `segment` is the number of the segment, `s` is metres along it."""

    x: Floats
    y: Floats
    height: Floats
    reach: Floats
    segment: Integers
    s: Floats


def relations_of(movements: list[Movement]) -> Relations:
    """Return which movements conflict and which share their origin. Raises `ValueError`: too many."""
    segments = list(dict.fromkeys(segment for movement in movements for segment in movement.segments))
    if not segments:
        none = np.empty((0, 2), dtype=np.int64)
        return Relations(none, np.empty(0), none, np.empty(0))
    number = {segment: place for place, segment in enumerate(segments)}
    first, second, last = _last_close_points(_sampled(segments), len(segments))
    # Every segment of every movement: its movement, its number and its offset on the movement, by segment.
    movement_of = np.repeat(np.arange(len(movements)), [len(movement.segments) for movement in movements])
    segment_of = np.array([number[segment] for movement in movements for segment in movement.segments])
    offset_of = np.concatenate([_offsets(movement) for movement in movements])
    order = np.argsort(segment_of, kind="stable")
    movement_of, segment_of, offset_of = movement_of[order], segment_of[order], offset_of[order]
    starts = np.searchsorted(segment_of, np.arange(len(segments) + 1))
    # All pairs (movement over `first`, movement over `second`) for each pair of close segments.
    uses = np.diff(starts)
    repeats = uses[first] * uses[second]
    refuse_many(int(repeats.sum()), MOST_CLOSE_MOVEMENTS, "pairs of movements come close to each other")
    pair = np.repeat(np.arange(len(first)), repeats)
    within = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    use_a = starts[first[pair]] + within // uses[second[pair]]
    use_b = starts[second[pair]] + within % uses[second[pair]]
    key = movement_of[use_b] * len(movements) + movement_of[use_a]
    along = offset_of[use_a] + last[pair]
    return _relations(movements, *_greatest(key, along))


def _relations(movements: list[Movement], key: Integers, along: Floats) -> Relations:
    """Sort pairs (movement, conflict) with the last place on the conflict into conflicts and siblings."""
    count = len(movements)
    numbers: dict[LaneSegment, int] = {}
    origin = np.array([numbers.setdefault(movement.origin, len(numbers)) for movement in movements])
    exits = np.array([numbers.setdefault(movement.exit, len(numbers)) for movement in movements])
    length = np.array([movement.length for movement in movements])
    first, second = key // count, key % count
    other = first != second
    first, second, along = first[other], second[other], along[other]
    along = np.minimum(along + _SPACING, length[second])
    same_exit = exits[first] == exits[second]
    same_origin = origin[first] == origin[second]
    release = np.where(same_exit, length[second], along)
    # Of siblings the distance is along the first of the two: look the pair up in reverse order.
    back = {(a, b): s for a, b, s in zip(second.tolist(), first.tolist(), along.tolist(), strict=True)}
    siblings = np.stack([first[same_origin], second[same_origin]], axis=1)
    shared = np.array([back[a, b] for a, b in siblings.tolist()], dtype=np.float64)
    conflicts = np.stack([first[~same_origin], second[~same_origin]], axis=1)
    return Relations(conflicts, release[~same_origin], siblings, shared)


def _offsets(movement: Movement) -> Floats:
    lengths = [segment.length for segment in movement.segments]
    return np.concatenate([[0.0], np.cumsum(lengths)[:-1]])


def _sampled(segments: list[LaneSegment]) -> _Points:
    length = np.array([segment.length for segment in segments])
    counts = np.maximum(2, np.ceil(length / _SPACING).astype(np.int64) + 1)
    refuse_many(int(counts.sum()), MOST_POINTS, "points lie on movements through junctions")
    segment = np.repeat(np.arange(len(segments)), counts)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    share = place / (counts[segment] - 1)
    s = share * length[segment]
    x, y, heading, curvature, low, high, width = (
        np.array([getattr(segment, name) for segment in segments])[segment]
        for name in ("x", "y", "heading", "curvature", "elevation", "end_elevation", "width")
    )
    # The chord of an arc: its length is s * sinc(half the turn), its direction half the turn.
    half = 0.5 * curvature * s
    chord = s * np.sinc(half / np.pi)
    return _Points(
        x=x + chord * np.cos(heading + half),
        y=y + chord * np.sin(heading + half),
        height=low + share * (high - low),
        reach=width * SHARE_OF_WIDTH,
        segment=segment,
        s=s,
    )


def _last_close_points(points: _Points, segments: int) -> tuple[Integers, Integers, Floats]:
    """Return ordered pairs of segments, and the last place (m) on the first that is close to the second."""
    keys, lasts = [], []
    for a, b in near_pairs(points.x, points.y, CLEARANCE, "points of movements"):
        distance = np.hypot(points.x[a] - points.x[b], points.y[a] - points.y[b])
        close = distance < np.minimum(CLEARANCE, points.reach[a] + points.reach[b])
        close &= np.abs(points.height[a] - points.height[b]) <= ROAD_LEVEL_HEIGHT
        keys.append(points.segment[a[close]] * segments + points.segment[b[close]])
        lasts.append(points.s[a[close]])
    key, last = _greatest(np.concatenate(keys), np.concatenate(lasts))
    return key // segments, key % segments, last


def _greatest(key: Integers, value: Floats) -> tuple[Integers, Floats]:
    """Return each key once, ascending, with its greatest value."""
    order = np.lexsort((value, key))
    key, value = key[order], value[order]
    is_last = np.append(key[1:] != key[:-1], True)
    return key[is_last], value[is_last]
