"""Which lanes vehicles can drive on for ever: all that can be reached from each other.

Ways that lead nowhere, and lanes that nothing leads to, are left out. A lane that ends is kept where one can
change from it to another. Marks that forbid a change of lane are followed, except where lanes could not be
reached from each other otherwise: there the change is allowed, in both directions.
"""

from dataclasses import dataclass

from athrl_driving.maps.opendrive.strips import LanePiece, Strip
from athrl_driving.maps.stretches import Way

Edges = list[list[int]]


@dataclass(frozen=True, slots=True)
class Drivable:
    """What is left for the traffic: the ordinary pieces (file order), ways, and neighbours to change to."""

    pieces: list[LanePiece]
    ways: list[Way]
    left: dict[LanePiece, LanePiece]
    right: dict[LanePiece, LanePiece]
    opened: int
    """Pairs of pieces between which a change is allowed although the marks forbid it."""


def drivable_part(strips: list[Strip], standing: set[LanePiece], ways: list[Way]) -> Drivable:
    """Return the largest part (by length) of the lanes in which every one can be reached from every other."""
    pieces = [piece for strip in strips for piece in strip.lanes if piece in standing]
    number = {piece: place for place, piece in enumerate(pieces)}
    pairs = [
        (number[left], number[right])
        for strip in strips
        for left, right in zip(strip.lanes, strip.lanes[1:], strict=False)
        if left in number and right in number and _beside(left, right)
    ]
    ahead = _ways_ahead(pieces, number, ways)
    anywhere = [list(targets) for targets in ahead]
    marked = [list(targets) for targets in ahead]
    for left, right in pairs:
        anywhere[left].append(right)
        anywhere[right].append(left)
        if pieces[left].may_right:
            marked[left].append(right)
        if pieces[right].may_left:
            marked[right].append(left)
    weights = [piece.length for piece in pieces] + [0.0] * len(ways)
    kept = _heaviest(components(anywhere), weights)
    part = components([[target for target in targets if kept[target]] for targets in marked])
    # Lanes in different parts cannot be reached from each other by the marks.
    kept_pairs = [
        (pieces[left], pieces[right], part[left] != part[right])
        for left, right in pairs
        if kept[left] and kept[right]
    ]
    return Drivable(
        pieces=[piece for place, piece in enumerate(pieces) if kept[place]],
        ways=[way for place, way in enumerate(ways, len(pieces)) if kept[place]],
        left={right: left for left, right, opens in kept_pairs if right.may_left or opens},
        right={left: right for left, right, opens in kept_pairs if left.may_right or opens},
        opened=sum(opens and not (left.may_right and right.may_left) for left, right, opens in kept_pairs),
    )


def _ways_ahead(pieces: list[LanePiece], number: dict[LanePiece, int], ways: list[Way]) -> Edges:
    """Return what follows each piece, and each way after them, without a change of lane."""
    links: Edges = [[number[after] for after in piece.successors if after in number] for piece in pieces]
    for place, way in enumerate(ways, len(pieces)):
        links[number[way.origin]].append(place)
        links.append([number[way.exit]])
    return links


def _beside(left: LanePiece, right: LanePiece) -> bool:
    """Tell whether two neighbours in a strip touch: no median or kerb lies between them."""
    distance = ((left.x - right.x) ** 2 + (left.y - right.y) ** 2) ** 0.5
    return distance < 0.5 * (left.width + right.width) + 0.5


def _heaviest(component: list[int], weights: list[float]) -> list[bool]:
    totals: dict[int, float] = {}
    for number, weight in zip(component, weights, strict=True):
        totals[number] = totals.get(number, 0.0) + weight
    best = max(totals, key=lambda number: totals[number])
    return [number == best for number in component]


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
