"""From a town's description to its lanes: trim the streets at the junctions, lay the lanes, connect them."""

import itertools
import math
from dataclasses import dataclass, field

from athrl_driving.maps.curves import Piece, Pose, join, rounded_polyline, wrap
from athrl_driving.maps.description import Node, Street, TownDescription
from athrl_driving.maps.lane_graph import TURN_LEFT, TURN_RIGHT, TURN_STRAIGHT
from athrl_driving.maps.roundabout import ARM_REACH, lay_roundabout
from athrl_driving.maps.sketch import Arm, Sketch

JUNCTION_ROOM = 10.5
"""Metres from a junction's centre to its stop lines, beside half the width of its widest road."""

_STRAIGHT_WITHIN = math.radians(35.0)


@dataclass
class _DirectedStreet:
    """The lanes of one direction, ids from the left; `pieces[lane][i]` starts at network node `nodes[i]`."""

    nodes: list[str]
    rows: list[list[int]] = field(default_factory=list)
    pieces: list[list[Piece]] = field(default_factory=list)


def sketch_town(description: TownDescription) -> Sketch:
    """Lay all lanes of a town.

    Raises `ValueError` that names the street or node where the description cannot be built.
    """
    nodes = {node.name: node for node in description.nodes}
    sketch = Sketch(lane_width=description.lane_width)
    arms: dict[str, list[Arm]] = {name: [] for name in nodes}
    for street in description.streets:
        for name in (street.start, street.end):
            if name not in nodes:
                raise ValueError(f"street {street.start} - {street.end}: there is no node named {name}")
        _lay_street(sketch, street, nodes, _setbacks(description), arms)
    for name, node in nodes.items():
        if len(arms[name]) < 3:
            raise ValueError(
                f"node {name}: {len(arms[name])} streets meet there, a junction needs at least 3"
            )
        if node.ring_radius > 0.0:
            lay_roundabout(sketch, node, arms[name])
        else:
            _lay_crossing(sketch, name, arms[name])
    return sketch


def _setbacks(description: TownDescription) -> dict[str, float]:
    """Return how far from each node's centre (m) its streets end."""
    result: dict[str, float] = {}
    for node in description.nodes:
        lanes = [street.lanes for street in description.streets if node.name in (street.start, street.end)]
        result[node.name] = JUNCTION_ROOM + description.lane_width * max(lanes, default=1)
        if node.ring_radius > 0.0:
            result[node.name] = node.ring_radius + ARM_REACH
    return result


def _lay_street(
    sketch: Sketch,
    street: Street,
    nodes: dict[str, Node],
    setbacks: dict[str, float],
    arms: dict[str, list[Arm]],
) -> None:
    start, end = nodes[street.start], nodes[street.end]
    corners = [
        (start.x, start.y, 0.0),
        *((bend.x, bend.y, bend.radius) for bend in street.bends),
        (end.x, end.y, 0.0),
    ]
    try:
        middle = rounded_polyline(corners)
        middle = _trimmed(middle, setbacks[street.start])
        middle = _reversed(_trimmed(_reversed(middle), setbacks[street.end]))
    except ValueError as error:
        raise ValueError(f"street {street.start} - {street.end}: {error}") from None
    forth = _lay_direction(sketch, street, f"{street.start}>{street.end}", middle)
    back = _lay_direction(sketch, street, f"{street.end}>{street.start}", _reversed(middle))
    arms[street.start].append(_arm(back, forth))
    arms[street.end].append(_arm(forth, back))


def _reversed(pieces: list[Piece]) -> list[Piece]:
    return [piece.backwards() for piece in reversed(pieces)]


def _trimmed(pieces: list[Piece], distance: float) -> list[Piece]:
    first = pieces[0]
    if first.curvature != 0.0 or first.length < distance + 1.0:
        raise ValueError(f"it must start straight for {distance + 1.0:.1f} m from each node")
    return [Piece(first.at(distance), 0.0, first.length - distance), *pieces[1:]]


def _lay_direction(sketch: Sketch, street: Street, name: str, middle: list[Piece]) -> _DirectedStreet:
    directed = _DirectedStreet(nodes=[f"{name}:{index}" for index in range(len(middle) + 1)])
    for lane in range(street.lanes):
        pieces = [piece.beside((lane + 0.5) * sketch.lane_width) for piece in middle]
        rows = [
            sketch.add(piece, (directed.nodes[index], directed.nodes[index + 1]), lane, street.speed_limit)
            for index, piece in enumerate(pieces)
        ]
        for row, following in itertools.pairwise(rows):
            sketch.lanes[row].successors.append(following)
        directed.rows.append(rows)
        directed.pieces.append(pieces)
    for index in range(len(middle)):
        for lane in range(street.lanes - 1):
            left, right = directed.rows[lane][index], directed.rows[lane + 1][index]
            sketch.lanes[left].right, sketch.lanes[right].left = right, left
    return directed


def _arm(incoming: _DirectedStreet, outgoing: _DirectedStreet) -> Arm:
    return Arm(
        incoming=[rows[-1] for rows in incoming.rows],
        outgoing=[rows[0] for rows in outgoing.rows],
        incoming_node=incoming.nodes[-1],
        outgoing_node=outgoing.nodes[0],
        direction=outgoing.pieces[0][0].start.heading,
    )


def _lay_crossing(sketch: Sketch, name: str, arms: list[Arm]) -> None:
    """Connect every arm with every other one: turns keep to their side, straight on keeps the lane."""
    junction = sketch.new_junction(name, "T-junction" if len(arms) == 3 else "crossing")
    for arm in arms:
        for target in arms:
            if target is arm:
                continue
            change = wrap(target.direction - (arm.direction + math.pi))
            turn = TURN_STRAIGHT
            if abs(change) > _STRAIGHT_WITHIN:
                turn = TURN_RIGHT if change > 0.0 else TURN_LEFT
            for entering, leaving in _lane_pairs(turn, len(arm.incoming), len(target.outgoing)):
                start: Pose = sketch.lanes[arm.incoming[entering]].piece.end
                end: Pose = sketch.lanes[target.outgoing[leaving]].piece.start
                try:
                    pieces = join(start, end)
                except ValueError as error:
                    raise ValueError(f"node {name}: {error}") from None
                sketch.add_movement(
                    pieces, arm.incoming[entering], target.outgoing[leaving], junction=junction, turn=turn
                )


def _lane_pairs(turn: int, entering: int, leaving: int) -> list[tuple[int, int]]:
    """Return which incoming lane (id from the left) leads to which outgoing lane."""
    if turn == TURN_LEFT:
        return [(0, 0)]
    if turn == TURN_RIGHT:
        return [(entering - 1, leaving - 1)]
    return [(min(lane, entering - 1), min(lane, leaving - 1)) for lane in range(max(entering, leaving))]
