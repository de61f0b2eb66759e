"""Lane links: the road network as background vehicles see it, built once a town from its lanes and movements.

A *link* is a chain of lanes of the lane graph without a fork: a movement, or the ordinary lanes between two
movements. A vehicle's path is a list of links, and its position is a distance along the first of them, so
kernels need not iterate over the many short lanes that a map may have.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps import Town
from athrl_driving.maps.compressed_lists import compressed
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph

CURVE_ACCELERATION = 2.2
"""m/s2 of lateral acceleration that background vehicles accept in a curve."""

CURVE_BRAKING = 2.0
"""m/s2 with which they brake towards a curve or a stop line."""

PENALTY_WHEN_YIELDING = 8.0
"""Seconds by which a request counts as later in the order of waiting if the movement yields."""

PENALTY_PER_PRIORITY = 1.0
"""Seconds of the same for each step of priority below the highest."""

PENALTY_ACROSS_AT_SIGNALS = 4.0
"""Seconds of the same for turns across oncoming vehicles that also have green."""

ROOM_TO_CHANGE = 16.0
"""Metres before the end of a dead-end lane where a vehicle waits for a gap beside."""

MOST_CHANGES = 8
"""Lanes that end side by side, beside one that goes on, at most; further ones lead nowhere."""

START_SPACING = 12.0
"""Metres between the centres of two places on a link where a vehicle may start."""

_SHORTEST_START = 20.0
_EDGE_MARGIN = 0.5
CELL = 16.0
"""Metres that a cell of the grid is wide."""

_REACH = 4.0


class LaneLinks(NamedTuple):
    """The K links of a town, of which the first M are its movements; L is the lanes of the lane graph."""

    link: Integers
    """[L] the link that the lane belongs to."""
    link_offset: Floats
    """[L] m along the link to the lane's start."""
    place: Integers
    """[L] the lane's place in `lanes`."""
    pace: Floats
    """[L] m/s: the speed limit, or what the curve allows."""
    entry_speed: Floats
    """[L] m/s with which the lane may be entered so that later lanes of its link are not entered too fast."""
    beside: Integers
    """[L, 2] the lane on the left and on the right, in the same direction, or -1."""
    mandatory_side: Integers
    """[L] where the link is a dead end, the side to which vehicles must change: 0 left, 1 right; else -1."""
    lane_start: Integers
    """[K+1]."""
    lanes: Integers
    """[L] lanes in the order of links."""
    length: Floats
    """[K] m."""
    room: Floats
    """[K] m on which vehicles can stand: the length, less on dead ends and at the map's edge."""
    leaves: NDArray[np.bool_]
    """[K] the road leaves the map at the link's end."""
    entries: Integers
    """[A] the links on which roads enter the map."""
    next_start: Integers
    """[K+1]."""
    next: Integers
    """[..] links that follow."""
    previous_start: Integers
    """[K+1]."""
    previous: Integers
    """[..] links that lead to it."""
    arrival_penalty: Floats
    """[M] s by which a request for the movement counts as later than it was made."""
    crossing_pace: Floats
    """[M] m/s: the least pace on the movement's lanes, 8 m/s at most."""
    signal: Integers
    """[M] the signal group that governs the movement, or -1."""
    start_link: Integers
    """[P] the links of places where a vehicle may start."""
    start_position: Floats
    """[P] m along the link to each place."""
    cell_origin: Floats
    """[2] m, least x and y of the grid."""
    cell_counts: Integers
    """[2] cells in x and y."""
    cell_start: Integers
    """[cells + 1]."""
    cell_lane: Integers
    """[..] lanes that a body with its centre in the cell may touch."""


def build_lane_links(town: Town) -> LaneLinks:
    """Return the links of a town."""
    graph, movements = town.graph, town.movements
    chains = [
        movements.lane[movements.lane_start[m] : movements.lane_start[m + 1]].tolist()
        for m in range(len(movements.length))
    ]
    movement_count = len(chains)
    chains += _ordinary_chains(graph)
    link, offset, place = _locate_lanes(graph, chains)
    following = [sorted({int(link[lane]) for lane in _successors(graph, chain[-1])}) for chain in chains]
    preceding: list[list[int]] = [[] for _ in chains]
    for number, links in enumerate(following):
        for after in links:
            preceding[after].append(number)
    length = np.array([float(graph.length[chain].sum()) for chain in chains])
    leaves = np.array([bool(graph.leaves[chain[-1]]) for chain in chains])
    ends = np.array([not links for links in following]) & ~leaves
    lane_start, lanes = compressed(chains)
    next_start, next_links = compressed(following)
    previous_start, previous_links = compressed(preceding)
    pace = _pace(graph)
    mandatory_sides = _mandatory_sides(graph, chains, ends)
    room = _rooms(graph, length, chains, ends, mandatory_sides, link, offset)
    room[leaves] -= _EDGE_MARGIN
    start_link, start_position = _starting_places(movement_count, room)
    return LaneLinks(
        link, offset, place, pace, _entry_speeds(graph, chains, pace), _beside(graph),
        mandatory_sides, lane_start, lanes, length, room,
        leaves, link[graph.enters],
        next_start, next_links, previous_start, previous_links, _arrival_penalties(town),
        np.array([min(8.0, float(pace[chain].min())) for chain in chains[:movement_count]]),
        np.asarray(movements.signal, dtype=np.int64), start_link, start_position, *_grid(graph),
    )  # fmt: skip


def _successors(graph: LaneGraph, lane: int) -> list[int]:
    return graph.successor[graph.successor_start[lane] : graph.successor_start[lane + 1]].tolist()


def _ordinary_chains(graph: LaneGraph) -> list[list[int]]:
    """Return the ordinary lanes as chains without forks and merges."""
    count = len(graph.length)
    before: list[list[int]] = [[] for _ in range(count)]
    for lane in range(count):
        for after in _successors(graph, lane):
            before[after].append(lane)

    def continues(lane: int) -> int:
        """Return the lane that follows in the same chain, or -1."""
        after = _successors(graph, lane)
        alone = len(after) == 1 and graph.movement[after[0]] < 0 and len(before[after[0]]) == 1
        return after[0] if alone else -1

    ordinary = [lane for lane in range(count) if graph.movement[lane] < 0]
    inner = {continues(lane) for lane in ordinary}
    chains: list[list[int]] = []
    seen: set[int] = set()
    # Lanes that no chain has reached lie on a ring without a junction, which is cut anywhere.
    for first in [lane for lane in ordinary if lane not in inner] + ordinary:
        if first in seen:
            continue
        chain, lane = [], first
        while lane >= 0 and lane not in seen:
            seen.add(lane)
            chain.append(lane)
            lane = continues(lane)
        on_a_ring = continues(chain[-1]) == first and len(chain) > 1
        # A ring becomes two links, so that a body across a link's end is not at both ends of the same link.
        middle = len(chain) // 2 if on_a_ring else len(chain)
        chains += [part for part in (chain[:middle], chain[middle:]) if part]
    return chains


def _locate_lanes(graph: LaneGraph, chains: list[list[int]]) -> tuple[Integers, Floats, Integers]:
    """Return every lane's link, the metres on the link before it, and its place in the list of all lanes."""
    count = len(graph.length)
    link, offset, place = np.full(count, -1), np.zeros(count), np.zeros(count, dtype=np.int64)
    number = 0
    for chain_number, chain in enumerate(chains):
        before = 0.0
        for lane in chain:
            link[lane], offset[lane], place[lane] = chain_number, before, number
            before += float(graph.length[lane])
            number += 1
    return link.astype(np.int64), offset, place


def _pace(graph: LaneGraph) -> Floats:
    with np.errstate(divide="ignore"):
        curve_speed = np.sqrt(CURVE_ACCELERATION / np.abs(graph.curvature))
    return np.minimum(graph.speed_limit, curve_speed)


def _entry_speeds(graph: LaneGraph, chains: list[list[int]], pace: Floats) -> Floats:
    speeds = pace.copy()
    for chain in chains:
        for lane, after in zip(chain[-2::-1], chain[:0:-1], strict=True):
            braked = math.sqrt(speeds[after] ** 2 + 2.0 * CURVE_BRAKING * graph.length[lane])
            speeds[lane] = min(pace[lane], braked)
    return speeds


def _beside(graph: LaneGraph) -> Integers:
    """Return the neighbours, also where only one of the two lanes may be left for the other."""
    beside = np.stack([graph.left, graph.right], axis=1).astype(np.int64)
    for side in (0, 1):
        for lane in np.flatnonzero(beside[:, side] >= 0):
            other = beside[lane, side]
            if beside[other, 1 - side] < 0:
                beside[other, 1 - side] = lane
    return beside


def _mandatory_sides(graph: LaneGraph, chains: list[list[int]], ends: NDArray[np.bool_]) -> Integers:
    """Return the side to which vehicles must change on every lane of dead-end links, else -1."""
    changes = np.full(len(graph.length), np.inf)
    mandatory_side = np.full(len(graph.length), -1, dtype=np.int64)
    for chain, ending in zip(chains, ends, strict=True):
        if not ending:
            changes[chain] = 0.0
    ending_lanes = [
        lane for chain, ending in zip(chains, ends, strict=True) if ending for lane in chain[::-1]
    ]
    for _ in range(MOST_CHANGES):
        for lane in ending_lanes:
            for side, neighbours in enumerate((graph.left, graph.right)):
                other = neighbours[lane]
                if other >= 0 and changes[other] + 1.0 < changes[lane]:
                    changes[lane], mandatory_side[lane] = changes[other] + 1.0, side
    return mandatory_side


def _rooms(
    graph: LaneGraph,
    length: Floats,
    chains: list[list[int]],
    ends: NDArray[np.bool_],
    mandatory_sides: Integers,
    link: Integers,
    offset: Floats,
) -> Floats:
    """Return the metres of each link on which vehicles can stand and still continue.

    A lane beside one that ends too is left where there is room for the next change on that.
    """
    room = np.where(ends, 0.0, length)
    beside = np.where(mandatory_sides == 0, graph.left, graph.right)
    changing = [[lane for lane in chain if mandatory_sides[lane] >= 0] for chain in chains]
    for _ in range(MOST_CHANGES):
        for number in np.flatnonzero(ends):
            until = [
                offset[lane] + _until_next_change(graph, lane, beside[lane], ends, room, link, offset)
                for lane in changing[number]
            ]
            room[number] = max(max(until, default=0.0) - ROOM_TO_CHANGE, 0.0)
    return room


def _until_next_change(
    graph: LaneGraph,
    lane: int,
    other: int,
    ends: NDArray[np.bool_],
    room: Floats,
    link: Integers,
    offset: Floats,
) -> float:
    """Return up to where (m) vehicles can change from a lane to the `other` beside it and still go on."""
    if not ends[link[other]]:
        return float(graph.length[lane])
    left = (room[link[other]] - offset[other]) / graph.length[other]
    return float(graph.length[lane]) * min(float(left), 1.0)


def _arrival_penalties(town: Town) -> Floats:
    movements = town.movements
    penalty = PENALTY_PER_PRIORITY * np.asarray(movements.priority, dtype=np.float64)
    penalty[np.asarray(movements.yields)] = PENALTY_WHEN_YIELDING
    # Odd priorities belong to turns across oncoming traffic: left turns, in left-hand traffic right turns.
    across = (np.asarray(movements.signal) >= 0) & (np.asarray(movements.priority) % 2 == 1)
    penalty[across] = np.maximum(penalty[across], PENALTY_ACROSS_AT_SIGNALS)
    return penalty


def _starting_places(movement_count: int, room: Floats) -> tuple[Integers, Floats]:
    links: list[int] = []
    along: list[float] = []
    for link in range(movement_count, len(room)):
        if room[link] < _SHORTEST_START:
            continue
        count = int(room[link] // START_SPACING)
        spacing = room[link] / count
        links += [link] * count
        along += [(number + 0.5) * spacing for number in range(count)]
    return np.array(links, dtype=np.int64), np.array(along, dtype=np.float64)


def _grid(graph: LaneGraph) -> tuple[Floats, Integers, Integers, Integers]:
    """Return a grid over the town with the lanes near each cell."""
    low, high = graph.box[:, :2].min(axis=0) - _REACH, graph.box[:, 2:].max(axis=0) + _REACH
    counts = np.maximum(np.ceil((high - low) / CELL), 1.0).astype(np.int64)
    cells: list[list[int]] = [[] for _ in range(int(counts.prod()))]
    first = np.floor((graph.box[:, :2] - _REACH - low) / CELL).astype(np.int64).clip(0, counts - 1)
    last = np.floor((graph.box[:, 2:] + _REACH - low) / CELL).astype(np.int64).clip(0, counts - 1)
    for lane, ((x0, y0), (x1, y1)) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        for cell_y in range(y0, y1 + 1):
            for cell_x in range(x0, x1 + 1):
                cells[cell_y * int(counts[0]) + cell_x].append(lane)
    return (low, counts, *compressed(cells))
