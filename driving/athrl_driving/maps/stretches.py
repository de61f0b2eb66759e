"""Where vehicles may stand and where they may not: stretches of ordinary road, and ways through junctions.

A way leads from a stretch on which a vehicle can stand to the next one. What lies between - junctions, and
pieces of ordinary road that are too short to stop on - belongs to the way: so whoever has left a junction
never has to wait with its rear in it, however close to each other junctions are.
"""

import logging
from collections import defaultdict
from dataclasses import dataclass, replace

from athrl_driving.maps.opendrive.merging import SHORTEST
from athrl_driving.maps.opendrive.strips import LanePiece, Strip

STANDING_LENGTH = 12.0
"""Metres of ordinary lane without a fork on which a vehicle may stand."""

FORK_LENGTH = 20.0
"""Metres before a merge and behind a fork of ordinary lanes that are treated like a junction."""

_MOST_PIECES = 200

_log = logging.getLogger(__name__)


@dataclass(eq=False, slots=True)
class Way:
    """A way through one or several junctions, from the last piece of a stretch to the first of the next."""

    origin: LanePiece
    pieces: list[LanePiece]
    exit: LanePiece

    @property
    def length(self) -> float:
        """Return the length in metres."""
        return sum(piece.length for piece in self.pieces)

    @property
    def junctions(self) -> list[str]:
        """Return the ids of the junctions on it, in driving order."""
        return list(dict.fromkeys(piece.junction for piece in self.pieces if piece.junction))


def all_pieces(strips: list[Strip]) -> list[LanePiece]:
    """Return the pieces of all strips, in order."""
    return [piece for strip in strips for piece in strip.lanes]


def predecessors_of(pieces: list[LanePiece]) -> dict[LanePiece, list[LanePiece]]:
    """Return for every piece those that lead to it."""
    result: dict[LanePiece, list[LanePiece]] = defaultdict(list)
    for piece in pieces:
        for following in piece.successors:
            result[following].append(piece)
    return result


def skip_very_short(strips: list[Strip]) -> None:
    """Take pieces out that carry nothing; the lanes before or behind them get their length."""
    predecessors = predecessors_of(all_pieces(strips))
    for strip in strips:
        for piece in list(strip.lanes):
            before, after = predecessors[piece], piece.successors
            if piece.length >= SHORTEST or not before or not after:
                continue
            if all(other.successors == [piece] for other in before):
                for other in before:
                    other.length += piece.length
            elif all(predecessors[other] == [piece] for other in after):
                for other in after:
                    _start_earlier(other, piece.length)
            else:
                continue
            _bypass(piece, predecessors)
            strip.lanes.remove(piece)
    strips[:] = [strip for strip in strips if strip.lanes]


def _start_earlier(piece: LanePiece, length: float) -> None:
    piece.x, piece.y, piece.heading = piece.at(-length)
    piece.length += length


def _bypass(piece: LanePiece, predecessors: dict[LanePiece, list[LanePiece]]) -> None:
    for before in predecessors[piece]:
        place = before.successors.index(piece)
        fresh = [after for after in piece.successors if after not in before.successors]
        before.successors[place : place + 1] = fresh
    for after in piece.successors:
        predecessors[after].remove(piece)
        predecessors[after] += [other for other in predecessors[piece] if other not in predecessors[after]]


def make_junctions_of_forks(strips: list[Strip]) -> None:
    """Turn the road around forks and merges of ordinary lanes into ways through a junction."""
    while True:
        pieces = all_pieces(strips)
        predecessors = predecessors_of(pieces)
        forks = (
            (piece, after) for piece in pieces if len(piece.successors) > 1 for after in piece.successors
        )
        fork = next(((a, b) for a, b in forks if not (a.junction or b.junction)), None)
        if fork is not None:
            before, after = fork
            first, _ = _split(strips, after.strip, min(FORK_LENGTH, 0.5 * after.length), after)
            first.junction = _place(before)
            continue
        merges = (
            (before, piece)
            for piece in pieces
            if len(predecessors[piece]) > 1
            for before in predecessors[piece]
        )
        merge = next(((a, b) for a, b in merges if not (a.junction or b.junction)), None)
        if merge is None:
            return
        before, after = merge
        length = before.length - min(FORK_LENGTH, 0.5 * before.length)
        _, last = _split(strips, before.strip, length, before)
        last.junction = _place(after)


def _place(piece: LanePiece) -> str:
    return f"road {piece.strip.road.id} at {piece.strip.start:.0f} m"


def _split(strips: list[Strip], strip: Strip, length: float, along: LanePiece) -> tuple[LanePiece, LanePiece]:
    """Cut all lanes of a strip where `along` is `length` metres long; return both parts of `along`."""
    share = length / along.length
    cut = strip.start + (share if strip.forward else 1.0 - share) * (strip.end - strip.start)
    start, end = (cut, strip.end) if strip.forward else (strip.start, cut)
    rest = Strip(strip.road, strip.forward, start, end, [])
    for piece in strip.lanes:
        x, y, heading = piece.at(share * piece.length)
        middle = piece.elevation + share * (piece.end_elevation - piece.elevation)
        second = replace(
            piece, x=x, y=y, heading=heading, length=(1.0 - share) * piece.length, elevation=middle
        )
        second.successors = piece.successors
        second.strip = rest
        piece.successors, piece.length, piece.end_elevation = [second], share * piece.length, middle
        rest.lanes.append(second)
    strip.start, strip.end = (strip.start, cut) if strip.forward else (cut, strip.end)
    strips.insert(strips.index(strip) + 1, rest)
    return along, rest.lanes[strip.lanes.index(along)]


def standing_pieces(pieces: list[LanePiece]) -> set[LanePiece]:
    """Return the ordinary pieces in chains without fork and merge that are long enough to stand on."""
    predecessors = predecessors_of(pieces)
    next_in_chain = {
        piece: piece.successors[0]
        for piece in pieces
        if len(piece.successors) == 1
        and not piece.junction
        and not piece.successors[0].junction
        and len(predecessors[piece.successors[0]]) == 1
    }
    inner = set(next_in_chain.values())
    standing: set[LanePiece] = set()
    visited: set[LanePiece] = set()
    # First the chains from their heads, then the closed loops, which have none.
    for head in [*(piece for piece in pieces if piece not in inner), *pieces]:
        if head.junction or head in visited:
            continue
        chain = [head]
        while (following := next_in_chain.get(chain[-1])) is not None and following is not head:
            chain.append(following)
        visited.update(chain)
        if sum(piece.length for piece in chain) >= STANDING_LENGTH:
            standing.update(chain)
    return standing


def find_ways(pieces: list[LanePiece], standing: set[LanePiece]) -> list[Way]:
    """Return all ways between standing pieces. None goes through a junction twice."""
    ways: list[Way] = []
    for origin in pieces:
        if origin not in standing:
            continue
        paths = [[after] for after in reversed(origin.successors) if after not in standing]
        while paths:
            path = paths.pop()
            last = path[-1]
            if len(path) > _MOST_PIECES:
                _log.warning(
                    "road %s: a way of more than %d pieces was cut", origin.strip.road.id, _MOST_PIECES
                )
                continue
            for after in reversed(last.successors):
                if after in standing:
                    ways.append(Way(origin, path, after))
                elif after not in path and not _returns(path, after):
                    paths.append([*path, after])
    return ways


def _returns(path: list[LanePiece], after: LanePiece) -> bool:
    """Tell whether `after` enters a junction that the path has been in and has left."""
    if not after.junction or path[-1].junction == after.junction:
        return False
    return any(piece.junction == after.junction for piece in path)
