"""What a town looks like to vehicles on rails: links, made once a town from its lanes and movements.

A *link* is a chain of rows of the lane graph without a fork: a movement, or the ordinary rows between two
movements. A vehicle's path is a list of links and its place a distance along the first of them, so nobody has
to walk over the many short rows that a map may have.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps import Town
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph

CURVE_ACCELERATION = 2.2
"""m/s2 sideways that background vehicles accept in a curve."""

CURVE_BRAKING = 2.0
"""m/s2 towards a curve or a stop line."""

LATER_WHEN_YIELDING = 8.0
"""Seconds that a movement which yields lets others pass it in the order of waiting."""

LATER_A_PRIORITY = 1.0
"""Seconds of the same for each step of priority that a movement is behind."""

LATER_ACROSS_AT_SIGNALS = 4.0
"""Seconds of the same for turns across oncoming vehicles that have green, too."""

ROOM_TO_CHANGE = 16.0
"""Metres before the end of a lane that ends where a vehicle waits for a gap beside."""

START_SPACING = 12.0
"""Metres between the centres of two places on a link where a vehicle may start."""

_SHORTEST_START = 20.0
CELL = 16.0
"""Metres that a cell of the grid is wide."""

_REACH = 4.0


class Rails(NamedTuple):
    """The links of a town, K rows, of which the first M are its movements; L rows of the lane graph."""

    link: Integers
    """[L] the link that the row belongs to."""
    link_offset: Floats
    """[L] m along the link to the row's start."""
    place: Integers
    """[L] where in `rows` the row stands."""
    pace: Floats
    """[L] m/s: the speed limit, or what the curve allows."""
    entry_speed: Floats
    """[L] m/s with which the row may be entered so that later rows of its link are not too fast."""
    beside: Integers
    """[L, 2] the row on the left and on the right, in the same direction, or -1."""
    way_out: Integers
    """[L] where the link ends without a way on: 0 change to the left, 1 to the right for one; else -1."""
    row_start: Integers
    """[K+1]."""
    rows: Integers
    """[L] rows in the order of links."""
    length: Floats
    """[K] m."""
    room: Floats
    """[K] m on which a vehicle can stand: the length, less in lanes that end."""
    next_start: Integers
    """[K+1]."""
    next: Integers
    """[..] links that follow."""
    previous_start: Integers
    """[K+1]."""
    previous: Integers
    """[..] links before."""
    later: Floats
    """[M] s that who asks for the movement lets others go first who come after it."""
    crossing_pace: Floats
    """[M] m/s, the least pace on the movement's rows, 8 m/s at most."""
    signal: Integers
    """[M] the signal group that governs the movement, or -1."""
    start_link: Integers
    """[P] links and"""
    start_position: Floats
    """[P] m along them where a vehicle may start."""
    cell_origin: Floats
    """[2] m, least x and y of the grid."""
    cell_counts: Integers
    """[2] cells in x and y."""
    cell_start: Integers
    """[cells + 1]."""
    cell_row: Integers
    """[..] rows that something in the cell may touch."""


def lay_rails(town: Town) -> Rails:
    """Return the links of a town."""
    graph, movements = town.graph, town.movements
    chains = [
        movements.lane[movements.lane_start[m] : movements.lane_start[m + 1]].tolist()
        for m in range(len(movements.length))
    ]
    ways = len(chains)
    chains += _ordinary_chains(graph)
    link, offset, place = _where_rows_are(graph, chains)
    following = [sorted({int(link[row]) for row in _successors(graph, chain[-1])}) for chain in chains]
    preceding: list[list[int]] = [[] for _ in chains]
    for number, links in enumerate(following):
        for after in links:
            preceding[after].append(number)
    length = np.array([float(graph.length[chain].sum()) for chain in chains])
    ends = np.array([not links for links in following])
    row_start, rows = compressed(chains)
    next_start, next_links = compressed(following)
    previous_start, previous_links = compressed(preceding)
    pace = _pace(graph)
    ways_out = _ways_out(graph, chains, ends)
    room = _rooms(length, chains, ends, ways_out, offset + graph.length)
    start_link, start_position = _starting_places(ways, room)
    return Rails(
        link, offset, place, pace, _entry_speeds(graph, chains, pace), _beside(graph),
        ways_out, row_start, rows, length, room,
        next_start, next_links, previous_start, previous_links, _handicaps(town),
        np.array([min(8.0, float(pace[chain].min())) for chain in chains[:ways]]),
        np.asarray(movements.signal, dtype=np.int64), start_link, start_position, *_grid(graph),
    )  # fmt: skip


def compressed(lists: list[list[int]]) -> tuple[Integers, Integers]:
    """Return lists in compressed form: starts [n + 1] and values."""
    starts = np.concatenate([[0], np.cumsum([len(values) for values in lists])]).astype(np.int64)
    return starts, np.array([value for values in lists for value in values], dtype=np.int64)


def _successors(graph: LaneGraph, row: int) -> list[int]:
    return graph.successor[graph.successor_start[row] : graph.successor_start[row + 1]].tolist()


def _ordinary_chains(graph: LaneGraph) -> list[list[int]]:
    """Return the ordinary rows in chains that have one way on and one way in."""
    count = len(graph.length)
    before: list[list[int]] = [[] for _ in range(count)]
    for row in range(count):
        for after in _successors(graph, row):
            before[after].append(row)

    def continues(row: int) -> int:
        """Return the row after, where the chain goes on with it, else -1."""
        after = _successors(graph, row)
        alone = len(after) == 1 and graph.movement[after[0]] < 0 and len(before[after[0]]) == 1
        return after[0] if alone else -1

    ordinary = [row for row in range(count) if graph.movement[row] < 0]
    inner = {continues(row) for row in ordinary}
    chains: list[list[int]] = []
    seen: set[int] = set()
    # Rows that no chain begins with lie on a ring without a junction, which is cut anywhere.
    for first in [row for row in ordinary if row not in inner] + ordinary:
        if first in seen:
            continue
        chain, row = [], first
        while row >= 0 and row not in seen:
            seen.add(row)
            chain.append(row)
            row = continues(row)
        on_a_ring = continues(chain[-1]) == first and len(chain) > 1
        # A ring is two links, so that a body across a link's end is not on both ends of one.
        middle = len(chain) // 2 if on_a_ring else len(chain)
        chains += [part for part in (chain[:middle], chain[middle:]) if part]
    return chains


def _where_rows_are(graph: LaneGraph, chains: list[list[int]]) -> tuple[Integers, Floats, Integers]:
    """Return for every row its link, the metres before it and its place in the list of all rows."""
    count = len(graph.length)
    link, offset, place = np.full(count, -1), np.zeros(count), np.zeros(count, dtype=np.int64)
    number = 0
    for chain_number, chain in enumerate(chains):
        before = 0.0
        for row in chain:
            link[row], offset[row], place[row] = chain_number, before, number
            before += float(graph.length[row])
            number += 1
    return link.astype(np.int64), offset, place


def _pace(graph: LaneGraph) -> Floats:
    with np.errstate(divide="ignore"):
        curve_speed = np.sqrt(CURVE_ACCELERATION / np.abs(graph.curvature))
    return np.minimum(graph.speed_limit, curve_speed)


def _entry_speeds(graph: LaneGraph, chains: list[list[int]], pace: Floats) -> Floats:
    speeds = pace.copy()
    for chain in chains:
        for row, after in zip(chain[-2::-1], chain[:0:-1], strict=True):
            braked = math.sqrt(speeds[after] ** 2 + 2.0 * CURVE_BRAKING * graph.length[row])
            speeds[row] = min(pace[row], braked)
    return speeds


def _beside(graph: LaneGraph) -> Integers:
    """Return the neighbours, also where only one of the two may change to the other."""
    beside = np.stack([graph.left, graph.right], axis=1).astype(np.int64)
    for side in (0, 1):
        for row in np.flatnonzero(beside[:, side] >= 0):
            other = beside[row, side]
            if beside[other, 1 - side] < 0:
                beside[other, 1 - side] = row
    return beside


def _ways_out(graph: LaneGraph, chains: list[list[int]], ends: NDArray[np.bool_]) -> Integers:
    """Return to which side a vehicle has to change on every row of links that end."""
    changes = np.full(len(graph.length), np.inf)
    way_out = np.full(len(graph.length), -1, dtype=np.int64)
    for chain, ending in zip(chains, ends, strict=True):
        if not ending:
            changes[chain] = 0.0
    ending_rows = [row for chain, ending in zip(chains, ends, strict=True) if ending for row in chain[::-1]]
    for _ in range(8):
        for row in ending_rows:
            for side, neighbours in enumerate((graph.left, graph.right)):
                other = neighbours[row]
                if other >= 0 and changes[other] + 1.0 < changes[row]:
                    changes[row], way_out[row] = changes[other] + 1.0, side
    return way_out


def _rooms(
    length: Floats, chains: list[list[int]], ends: NDArray[np.bool_], ways_out: Integers, until: Floats
) -> Floats:
    """Return on how many metres of a link vehicles can stand and still go on; `until` is where rows end."""
    room = length.copy()
    for link in np.flatnonzero(ends):
        beside = [until[row] for row in chains[link] if ways_out[row] >= 0]
        room[link] = max(max(beside, default=0.0) - ROOM_TO_CHANGE, 0.0)
    return room


def _handicaps(town: Town) -> Floats:
    movements = town.movements
    later = LATER_A_PRIORITY * np.asarray(movements.priority, dtype=np.float64)
    later[np.asarray(movements.yields)] = LATER_WHEN_YIELDING
    # Odd priorities are those of turns across the oncoming traffic: left turns, with left-hand traffic right.
    across = (np.asarray(movements.signal) >= 0) & (np.asarray(movements.priority) % 2 == 1)
    later[across] = np.maximum(later[across], LATER_ACROSS_AT_SIGNALS)
    return later


def _starting_places(ways: int, room: Floats) -> tuple[Integers, Floats]:
    links: list[int] = []
    along: list[float] = []
    for link in range(ways, len(room)):
        if room[link] < _SHORTEST_START:
            continue
        count = int(room[link] // START_SPACING)
        spacing = room[link] / count
        links += [link] * count
        along += [(number + 0.5) * spacing for number in range(count)]
    return np.array(links, dtype=np.int64), np.array(along, dtype=np.float64)


def _grid(graph: LaneGraph) -> tuple[Floats, Integers, Integers, Integers]:
    """Return a grid over the town with the rows near each cell."""
    low, high = graph.box[:, :2].min(axis=0) - _REACH, graph.box[:, 2:].max(axis=0) + _REACH
    counts = np.maximum(np.ceil((high - low) / CELL), 1.0).astype(np.int64)
    cells: list[list[int]] = [[] for _ in range(int(counts.prod()))]
    first = np.floor((graph.box[:, :2] - _REACH - low) / CELL).astype(np.int64).clip(0, counts - 1)
    last = np.floor((graph.box[:, 2:] + _REACH - low) / CELL).astype(np.int64).clip(0, counts - 1)
    for row, ((x0, y0), (x1, y1)) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        for cell_y in range(y0, y1 + 1):
            for cell_x in range(x0, x1 + 1):
                cells[cell_y * int(counts[0]) + cell_x].append(row)
    return (low, counts, *compressed(cells))
