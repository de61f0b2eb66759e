"""Which ways through junctions get in each other's way, from their geometry.

Two vehicles whose centre lines come closer than `CLEARANCE` cannot pass each other, unless one road is above
the other. Ways that start from the same lane are no conflict: their vehicles follow each other until the ways
have parted. Ways that lead to the same lane are. Everything is found from points sampled along the pieces,
hashed into cells; so it takes the same time however the junctions are joined.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.opendrive.strips import LanePiece
from athrl_driving.maps.stretches import Way

CLEARANCE = 3.0
"""Metres between two centre lines: a vehicle's width, what its corners sweep in a turn, and a margin."""

LEVEL_HEIGHT = 3.0
"""Metres of height between two roads of which one passes over the other."""

_SPACING = 0.5
_SHARE_OF_WIDTH = 0.43
"""Of two lanes' widths together: on narrow lanes vehicles keep a smaller distance than `CLEARANCE`."""

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Relations:
    """Ordered pairs of ways, sorted by (first, second), with a distance in metres.

    Of conflicts: how far along the second a vehicle's rear must be to be out of the first's way. Of siblings
    (the same origin): over which distance from the origin the two share the road.
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
    """Points along pieces; `piece` is the piece's number, `s` metres along it."""

    x: Floats
    y: Floats
    height: Floats
    reach: Floats
    piece: Integers
    s: Floats


def relations_of(ways: list[Way]) -> Relations:
    """Return who meets whom."""
    pieces = list(dict.fromkeys(piece for way in ways for piece in way.pieces))
    if not pieces:
        none = np.empty((0, 2), dtype=np.int64)
        return Relations(none, np.empty(0), none, np.empty(0))
    number = {piece: place for place, piece in enumerate(pieces)}
    first, second, last = _last_meetings(_sampled(pieces), len(pieces))
    # Every piece of every way: which way, which piece, where on the way it starts, sorted by piece.
    way_of = np.repeat(np.arange(len(ways)), [len(way.pieces) for way in ways])
    piece_of = np.array([number[piece] for way in ways for piece in way.pieces])
    offset_of = np.concatenate([_offsets(way) for way in ways])
    order = np.argsort(piece_of, kind="stable")
    way_of, piece_of, offset_of = way_of[order], piece_of[order], offset_of[order]
    starts = np.searchsorted(piece_of, np.arange(len(pieces) + 1))
    # All pairs (way over `first`, way over `second`) for each meeting.
    uses = np.diff(starts)
    repeats = uses[first] * uses[second]
    meeting = np.repeat(np.arange(len(first)), repeats)
    within = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    use_a = starts[first[meeting]] + within // uses[second[meeting]]
    use_b = starts[second[meeting]] + within % uses[second[meeting]]
    key = way_of[use_b] * len(ways) + way_of[use_a]
    along = offset_of[use_a] + last[meeting]
    return _relations(ways, *_greatest(key, along))


def _relations(ways: list[Way], key: Integers, along: Floats) -> Relations:
    """Sort pairs (way, conflict) with the last place on the conflict into conflicts and siblings."""
    count = len(ways)
    numbers: dict[LanePiece, int] = {}
    origin = np.array([numbers.setdefault(way.origin, len(numbers)) for way in ways])
    exits = np.array([numbers.setdefault(way.exit, len(numbers)) for way in ways])
    length = np.array([way.length for way in ways])
    first, second = key // count, key % count
    other = first != second
    first, second, along = first[other], second[other], along[other]
    along = np.minimum(along + _SPACING, length[second])
    same_exit = exits[first] == exits[second]
    same_origin = origin[first] == origin[second]
    release = np.where(same_exit, length[second], along)
    # Of siblings the distance is along the first of the two: look the pair up the other way round.
    back = {(a, b): s for a, b, s in zip(second.tolist(), first.tolist(), along.tolist(), strict=True)}
    siblings = np.stack([first[same_origin], second[same_origin]], axis=1)
    shared = np.array([back[a, b] for a, b in siblings.tolist()], dtype=np.float64)
    conflicts = np.stack([first[~same_origin], second[~same_origin]], axis=1)
    return Relations(conflicts, release[~same_origin], siblings, shared)


def _offsets(way: Way) -> Floats:
    lengths = [piece.length for piece in way.pieces]
    return np.concatenate([[0.0], np.cumsum(lengths)[:-1]])


def _sampled(pieces: list[LanePiece]) -> _Points:
    length = np.array([piece.length for piece in pieces])
    counts = np.maximum(2, np.ceil(length / _SPACING).astype(np.int64) + 1)
    piece = np.repeat(np.arange(len(pieces)), counts)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    share = place / (counts[piece] - 1)
    s = share * length[piece]
    x, y, heading, curvature, low, high, width = (
        np.array([getattr(piece, name) for piece in pieces])[piece]
        for name in ("x", "y", "heading", "curvature", "elevation", "end_elevation", "width")
    )
    # The chord of an arc: its length is s * sinc(half the turn), its direction half the turn.
    half = 0.5 * curvature * s
    chord = s * np.sinc(half / np.pi)
    return _Points(
        x=x + chord * np.cos(heading + half),
        y=y + chord * np.sin(heading + half),
        height=low + share * (high - low),
        reach=width * _SHARE_OF_WIDTH,
        piece=piece,
        s=s,
    )


def _last_meetings(points: _Points, pieces: int) -> tuple[Integers, Integers, Floats]:
    """Return for ordered pairs of pieces the last place (m) on the first that is close to the second."""
    column = np.floor((points.x - points.x.min()) / CLEARANCE).astype(np.int64) + 1
    row = np.floor((points.y - points.y.min()) / CLEARANCE).astype(np.int64) + 1
    columns = int(column.max()) + 2
    cell = row * columns + column
    order = np.argsort(cell, kind="stable")
    sorted_cell = cell[order]
    keys, lasts = [], []
    for shift in (-columns - 1, -columns, -columns + 1, -1, 0, 1, columns - 1, columns, columns + 1):
        begin = np.searchsorted(sorted_cell, cell + shift)
        count = np.searchsorted(sorted_cell, cell + shift, side="right") - begin
        a = np.repeat(np.arange(len(cell)), count)
        b = order[
            np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
        ]
        distance = np.hypot(points.x[a] - points.x[b], points.y[a] - points.y[b])
        close = distance < np.minimum(CLEARANCE, points.reach[a] + points.reach[b])
        close &= np.abs(points.height[a] - points.height[b]) <= LEVEL_HEIGHT
        keys.append(points.piece[a[close]] * pieces + points.piece[b[close]])
        lasts.append(points.s[a[close]])
    key, last = _greatest(np.concatenate(keys), np.concatenate(lasts))
    return key // pieces, key % pieces, last


def _greatest(key: Integers, value: Floats) -> tuple[Integers, Floats]:
    """Return each key once, ascending, with its greatest value."""
    order = np.lexsort((value, key))
    key, value = key[order], value[order]
    is_last = np.append(key[1:] != key[:-1], True)
    return key[is_last], value[is_last]
