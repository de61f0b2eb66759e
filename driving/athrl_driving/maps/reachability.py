"""Which lanes vehicles can drive on without end: round and round, or in from outside and out again.

Lanes that can be reached from each other are one part of the map. A map may have several, as the two
directions of a ring road, and all are kept. An open map is one whose roads end at its edge: vehicles leave it
there, and others enter where roads begin. For the search the outside is one more node, which every exit leads
to and which leads to every entry; so a way from an entry to an exit is a part as a loop is.

Movements that lead nowhere, and lanes that nothing leads to, are left out. So are stubs and pieces of roads
at the edge of a map that has much more to drive on. A lane that ends is kept where vehicles can change from
it to another. Marks that forbid a lane change are obeyed, except where lanes could not be reached from each
other otherwise: there the change is allowed, in both directions.
"""

from collections import defaultdict
from dataclasses import dataclass

from athrl_driving.maps.open_ends import Edges, Pairs, open_ends
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.standing_segments import Movement

LEAST_OPEN_SHARE = 0.02
"""Of the metres of loops: where open roads add less, they are stubs, and the map counts as closed."""

SHORTEST_PIECE = 200.0
"""Metres of lane below which an open road that touches no loop is left out of a map that has loops."""

_NO_PART = -1


@dataclass(frozen=True, slots=True)
class Drivable:
    """What the traffic can use: ordinary segments (in file order), movements, and what is around them."""

    segments: list[LaneSegment]
    movements: list[Movement]
    ahead: dict[LaneSegment, list[LaneSegment]]
    """By segment: the segments that follow it without a movement, none where it ends."""
    left: dict[LaneSegment, LaneSegment]
    right: dict[LaneSegment, LaneSegment]
    """Neighbours to change to."""
    enters: set[LaneSegment]
    """Segments at whose start their road enters the map; none on a closed map."""
    leaves: set[LaneSegment]
    """Segments at whose end their road leaves the map."""
    opened: int
    """Pairs of segments between which a change is allowed although the marks forbid it."""


def drivable_part(
    carriageways: list[Carriageway], standing: set[LaneSegment], movements: list[Movement]
) -> Drivable:
    """Return all lanes on which vehicles can drive without end; nothing where there are none."""
    segments = [
        segment for carriageway in carriageways for segment in carriageway.lanes if segment in standing
    ]
    number = {segment: place for place, segment in enumerate(segments)}
    pairs = [
        (number[left], number[right])
        for carriageway in carriageways
        for left, right in zip(carriageway.lanes, carriageway.lanes[1:], strict=False)
        if left in number and right in number and _beside(left, right)
    ]
    ahead = _edges_ahead(segments, number, movements)
    part, enters, leaves = _parts_of_map(segments, movements, ahead, pairs)
    ahead = [
        [target for target in targets if part[target] == part[node]] for node, targets in enumerate(ahead)
    ]
    marked = _reachable_by_the_marks(segments, ahead, pairs, enters, leaves)
    # Lanes in different components cannot be reached from each other by the marks.
    kept_pairs = [
        (segments[left], segments[right], marked[left] != marked[right])
        for left, right in pairs
        if part[left] != _NO_PART and part[right] != _NO_PART
    ]
    return Drivable(
        segments=[segment for place, segment in enumerate(segments) if part[place] != _NO_PART],
        movements=[
            movement for place, movement in enumerate(movements, len(segments)) if part[place] != _NO_PART
        ],
        ahead={
            segment: [segments[target] for target in ahead[place] if target < len(segments)]
            for place, segment in enumerate(segments)
            if part[place] != _NO_PART
        },
        left={right: left for left, right, opens in kept_pairs if right.may_left or opens},
        right={left: right for left, right, opens in kept_pairs if left.may_right or opens},
        enters={segments[place] for place in enters},
        leaves={segments[place] for place in leaves},
        opened=sum(opens and not (left.may_right and right.may_left) for left, right, opens in kept_pairs),
    )


def _parts_of_map(
    segments: list[LaneSegment], movements: list[Movement], ahead: Edges, pairs: Pairs
) -> tuple[list[int], list[int], list[int]]:
    """Return the part of every node, and the lanes on which roads enter and leave the map."""
    # What was prolonged is shorter than a vehicle in the file: no reason to open a map that has loops.
    metres = [0.0 if segment.prolonged else segment.length for segment in segments]
    metres += [0.0] * (len(ahead) - len(segments))
    loops = _parts(ahead, pairs)
    enters, leaves = open_ends(len(segments), ahead, pairs)
    outside = len(ahead)
    parts = _parts(_through_outside(ahead, enters, leaves), pairs)
    if any(part != _NO_PART for part in loops):
        _drop_pieces(parts, loops, _touching(segments, movements, ahead), metres)
    on_loops, driven = (
        sum(length for part, length in zip(all_parts, metres, strict=False) if part != _NO_PART)
        for all_parts in (loops, parts)
    )
    if driven - on_loops < LEAST_OPEN_SHARE * on_loops:
        return loops, [], []
    enters, leaves = (
        [lane for lane in lanes if parts[lane] == parts[outside] != _NO_PART] for lanes in (enters, leaves)
    )
    return parts[:outside], enters, leaves


def _through_outside(ahead: Edges, enters: list[int], leaves: list[int]) -> Edges:
    """Return the edges with one more node, the outside: from where roads leave to where they enter."""
    through = [list(targets) for targets in ahead]
    for lane in leaves:
        through[lane].append(len(ahead))
    return [*through, list(enters)]


def _touching(segments: list[LaneSegment], movements: list[Movement], ahead: Edges) -> Edges:
    """Return what is connected with each node: before or behind it, or on the same road or junction."""
    around: Edges = [[] for _ in ahead]
    _join(around, [(node, target) for node, targets in enumerate(ahead) for target in targets])
    places = [[("road", segment.carriageway.road.id)] for segment in segments]
    places += [[("junction", junction) for junction in movement.junctions] for movement in movements]
    first: dict[tuple[str, str], int] = {}
    for node, own in enumerate(places):
        _join(around, [(first.setdefault(place, node), node) for place in own])
    return around


def _join(edges: Edges, pairs: Pairs) -> None:
    for left, right in pairs:
        edges[left].append(right)
        edges[right].append(left)


def _parts(ahead: Edges, pairs: Pairs) -> list[int]:
    """Return the part that each node is in, `_NO_PART` where one cannot drive on without end."""
    edges = [list(targets) for targets in ahead]
    _join(edges, pairs)
    component = components(edges)
    # Two lanes that end beside each other can be reached from each other too, but lead nowhere.
    endless = {
        component[node]
        for node, targets in enumerate(ahead)
        for target in targets
        if component[node] == component[target]
    }
    return [number if number in endless else _NO_PART for number in component]


def _drop_pieces(parts: list[int], loops: list[int], around: Edges, metres: list[float]) -> None:
    """Take short open roads that touch no loop out of the part that leads outside."""
    outside = parts[-1]
    driven = [part != _NO_PART for part in parts]
    piece = components(
        [
            [other for other in others if driven[other]] if driven[node] else []
            for node, others in enumerate(around)
        ]
    )
    length: dict[int, float] = defaultdict(float)
    for node, number in enumerate(piece):
        length[number] += metres[node] if loops[node] == _NO_PART else SHORTEST_PIECE
    for node, number in enumerate(piece):
        if parts[node] == outside != _NO_PART and length[number] < SHORTEST_PIECE:
            parts[node] = _NO_PART


def _reachable_by_the_marks(
    segments: list[LaneSegment], ahead: Edges, pairs: Pairs, enters: list[int], leaves: list[int]
) -> list[int]:
    """Return the same number for nodes that can be reached from each other without crossing a solid mark."""
    edges = _through_outside(ahead, enters, leaves)
    for left, right in pairs:
        if segments[left].may_right:
            edges[left].append(right)
        if segments[right].may_left:
            edges[right].append(left)
    return components(edges)


def _edges_ahead(
    segments: list[LaneSegment], number: dict[LaneSegment, int], movements: list[Movement]
) -> Edges:
    """Return what follows each segment, and then each movement, without a lane change."""
    links: Edges = [
        [number[after] for after in segment.successors if after in number] for segment in segments
    ]
    for place, movement in enumerate(movements, len(segments)):
        links[number[movement.origin]].append(place)
        links.append([number[movement.exit]])
    return links


def _beside(left: LaneSegment, right: LaneSegment) -> bool:
    """Tell whether two neighbours in a carriageway touch: no median or kerb lies between them."""
    distance = ((left.x - right.x) ** 2 + (left.y - right.y) ** 2) ** 0.5
    return distance < 0.5 * (left.width + right.width) + 0.5


def components(edges: Edges) -> list[int]:
    """Return the strongly connected component of every node (Tarjan's algorithm, without recursion)."""
    count = len(edges)
    order, low, component = [-1] * count, [0] * count, [-1] * count
    open_nodes: list[int] = []
    visited = found = 0
    for root in range(count):
        if order[root] >= 0:
            continue
        work = [(root, 0)]
        while work:
            node, place = work.pop()
            if place == 0:
                order[node] = low[node] = visited
                visited += 1
                open_nodes.append(node)
            else:
                low[node] = min(low[node], low[edges[node][place - 1]])
            while place < len(edges[node]):
                target = edges[node][place]
                place += 1
                if order[target] < 0:
                    work += [(node, place), (target, 0)]
                    break
                if component[target] < 0:
                    low[node] = min(low[node], order[target])
            else:
                if low[node] == order[node]:
                    while component[node] < 0:
                        component[open_nodes.pop()] = found
                    found += 1
    return component
