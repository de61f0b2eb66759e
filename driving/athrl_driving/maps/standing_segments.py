"""Where vehicles may stand: on standing segments of ordinary road, not on movements through junctions.

A movement leads from ordinary road on which a vehicle can stand to the next such road. What lies between -
junctions, and ordinary segments that are too short to stop on - belongs to the movement. So a vehicle that
has left a junction never has to wait with its rear in it, however close to each other junctions are.
"""

import logging
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

from athrl_driving.maps.findings import MapError
from athrl_driving.maps.opendrive.bounds import (
    MOST_FORK_STEPS,
    MOST_MOVEMENT_LANES,
    MOST_MOVEMENTS,
    MOST_PATHS,
)
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.opendrive.merging import SHORTEST
from athrl_driving.maps.overlaps import chain_from, overlap
from athrl_driving.maps.splitting import split

STANDING_LENGTH = 12.0
"""Metres of ordinary lane without a fork on which a vehicle may stand."""

FORK_LENGTH = 20.0
"""Metres before a merge and behind a fork of ordinary lanes that are treated like a junction."""

_MOST_SEGMENTS = 200

_log = logging.getLogger(__name__)


@dataclass(eq=False, slots=True)
class Movement:
    """A movement through one or several junctions, from one standing segment to the next."""

    origin: LaneSegment
    segments: list[LaneSegment]
    exit: LaneSegment

    @property
    def length(self) -> float:
        """Return the length in metres."""
        return sum(segment.length for segment in self.segments)

    @property
    def junctions(self) -> list[str]:
        """Return the ids of the junctions on it, in driving order."""
        return list(dict.fromkeys(segment.junction for segment in self.segments if segment.junction))


def all_segments(carriageways: list[Carriageway]) -> list[LaneSegment]:
    """Return the segments of all carriageways, in order."""
    return [segment for carriageway in carriageways for segment in carriageway.lanes]


def predecessors_of(segments: list[LaneSegment]) -> dict[LaneSegment, list[LaneSegment]]:
    """Return the segments that lead to each segment."""
    result: dict[LaneSegment, list[LaneSegment]] = defaultdict(list)
    for segment in segments:
        for following in segment.successors:
            result[following].append(segment)
    return result


def skip_very_short(carriageways: list[Carriageway]) -> None:
    """Remove segments too short for a vehicle; the segments before or behind them get their length."""
    predecessors = predecessors_of(all_segments(carriageways))
    for carriageway in carriageways:
        for segment in list(carriageway.lanes):
            before, after = predecessors[segment], segment.successors
            if segment.length >= SHORTEST or not before or not after:
                continue
            if all(other.successors == [segment] for other in before):
                for other in before:
                    other.length += segment.length
            elif all(predecessors[other] == [segment] for other in after):
                for other in after:
                    _start_earlier(other, segment.length)
            else:
                continue
            _bypass(segment, predecessors)
            carriageway.lanes.remove(segment)
    carriageways[:] = [carriageway for carriageway in carriageways if carriageway.lanes]


def _start_earlier(segment: LaneSegment, length: float) -> None:
    segment.x, segment.y, segment.heading = segment.at(-length)
    segment.length += length


def _bypass(segment: LaneSegment, predecessors: dict[LaneSegment, list[LaneSegment]]) -> None:
    for before in predecessors[segment]:
        place = before.successors.index(segment)
        fresh = [after for after in segment.successors if after not in before.successors]
        before.successors[place : place + 1] = fresh
    for after in segment.successors:
        predecessors[after].remove(segment)
        predecessors[after] += [other for other in predecessors[segment] if other not in predecessors[after]]


def make_junctions_of_forks(carriageways: list[Carriageway]) -> None:
    """Turn the road around forks and merges of ordinary lanes into junctions. Raises `ValueError`."""
    steps = 0
    while True:
        segments = all_segments(carriageways)
        steps += len(segments)
        if steps > MOST_FORK_STEPS:
            raise ValueError(f"too many of its {len(segments):,} lanes fork or merge outside junctions")
        predecessors = predecessors_of(segments)
        forks = (
            (segment, after)
            for segment in segments
            if len(segment.successors) > 1
            for after in segment.successors
        )
        fork = next(((a, b) for a, b in forks if not (a.junction or b.junction)), None)
        if fork is not None:
            before, after = fork
            beside = [other for other in before.successors if other is not after]
            _take(carriageways, after, beside, _successors_of(segments), _place(before))
            continue
        merges = (
            (before, segment)
            for segment in segments
            if len(predecessors[segment]) > 1
            for before in predecessors[segment]
        )
        merge = next(((a, b) for a, b in merges if not (a.junction or b.junction)), None)
        if merge is None:
            return
        before, after = merge
        beside = [other for other in predecessors[after] if other is not before]
        _take(carriageways, before, beside, predecessors, _place(after), forward=False)


def _successors_of(segments: list[LaneSegment]) -> dict[LaneSegment, list[LaneSegment]]:
    return {segment: segment.successors for segment in segments}


def _take(
    carriageways: list[Carriageway],
    segment: LaneSegment,
    beside: list[LaneSegment],
    onwards: dict[LaneSegment, list[LaneSegment]],
    place: str,
    forward: bool = True,
) -> None:
    """Make the part of a lane behind a fork (or before a merge: not `forward`) a junction.

    It is `FORK_LENGTH` long, and longer where the lanes `beside` lie over it farther.
    """
    length = min(FORK_LENGTH, 0.5 * segment.length)
    chain = chain_from(segment, onwards)
    over = max(overlap(chain, chain_from(other, onwards), forward) for other in beside)
    if over > FORK_LENGTH:
        length = max(length, min(over, 0.5 * sum(part.length for part in chain)))
    for part in chain:
        if length < part.length - SHORTEST:
            cut = length if forward else part.length - length
            place_in_row, carriageway = part.carriageway.lanes.index(part), part.carriageway
            rest = split(carriageway, cut / part.length)
            carriageways.insert(carriageways.index(carriageway) + 1, rest)
            (part if forward else rest.lanes[place_in_row]).junction = place
            return
        part.junction = place
        length -= part.length
        if length < SHORTEST:  # nothing of the next part: a piece without length would be no lane
            return


def _place(segment: LaneSegment) -> str:
    return f"road {segment.carriageway.road.id} at {segment.carriageway.start:.0f} m"


def standing_segments(name: str, segments: list[LaneSegment]) -> set[LaneSegment]:
    """Return the ordinary segments in chains without forks and merges that are long enough to stand on.

    Raises `MapError`, which begins with the `name` of the map's file, where there are none.
    """
    standing: set[LaneSegment] = set()
    longest = 0.0
    for chain in _chains(segments):
        length = sum(segment.length for segment in chain)
        longest = max(longest, length)
        if length >= STANDING_LENGTH:
            standing.update(chain)
    if not standing:
        raise MapError(
            f"{name}: no lane is long enough to stand on: the longest outside junctions has {longest:.2f} m, "
            f"one at least must have {STANDING_LENGTH:g} m"
        )
    return standing


def _chains(segments: list[LaneSegment]) -> Iterator[list[LaneSegment]]:
    """Yield the ordinary segments as chains without forks and merges."""
    predecessors = predecessors_of(segments)
    next_in_chain = {
        segment: segment.successors[0]
        for segment in segments
        if len(segment.successors) == 1
        and not segment.junction
        and not segment.successors[0].junction
        and len(predecessors[segment.successors[0]]) == 1
    }
    inner = set(next_in_chain.values())
    visited: set[LaneSegment] = set()
    # First the chains from their heads, then the closed loops, which have none.
    for head in [*(segment for segment in segments if segment not in inner), *segments]:
        if head.junction or head in visited:
            continue
        chain = [head]
        while (following := next_in_chain.get(chain[-1])) is not None and following is not head:
            chain.append(following)
        visited.update(chain)
        yield chain


def find_movements(segments: list[LaneSegment], standing: set[LaneSegment]) -> list[Movement]:
    """Return all movements between standing segments. None goes through a junction twice.

    Raises `ValueError` where there are too many.
    """
    movements: list[Movement] = []
    tried = lanes = 0
    for origin in segments:
        if origin not in standing:
            continue
        paths = [[after] for after in reversed(origin.successors) if after not in standing]
        while paths:
            path = paths.pop()
            last = path[-1]
            tried += 1
            if tried > MOST_PATHS or len(movements) > MOST_MOVEMENTS or lanes > MOST_MOVEMENT_LANES:
                raise ValueError(
                    f"too many ways lead through junctions up to road {origin.carriageway.road.id}, at most "
                    f"{MOST_MOVEMENTS:,} with {MOST_MOVEMENT_LANES:,} lanes are allowed"
                )
            if len(path) > _MOST_SEGMENTS:
                _log.warning(
                    "road %s: a movement of more than %d segments was cut",
                    origin.carriageway.road.id,
                    _MOST_SEGMENTS,
                )
                continue
            for after in reversed(last.successors):
                if after in standing:
                    movements.append(Movement(origin, path, after))
                    lanes += len(path)
                elif after not in path and not _returns(path, after):
                    paths.append([*path, after])
    return movements


def _returns(path: list[LaneSegment], after: LaneSegment) -> bool:
    """Tell whether `after` enters a junction that the path has been in and has left."""
    if not after.junction or path[-1].junction == after.junction:
        return False
    return any(segment.junction == after.junction for segment in path)
