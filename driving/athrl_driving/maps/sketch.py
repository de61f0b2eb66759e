"""A town's lanes while they are being laid: lists that grow, before they become arrays."""

import itertools
from dataclasses import dataclass, field

from athrl_driving.maps.curves import Piece
from athrl_driving.maps.lane_graph import TURN_STRAIGHT


@dataclass
class SketchedLane:
    """One lane. `nodes` and `identifier` make highway-env's lane index; `identifier` counts from the left."""

    piece: Piece
    nodes: tuple[str, str]
    identifier: int
    speed_limit: float
    successors: list[int] = field(default_factory=list)
    left: int = -1
    right: int = -1
    junction: int = -1
    turn: int = TURN_STRAIGHT
    movement: int = -1


@dataclass
class SketchedMovement:
    """A way through a junction: the rows between an incoming and an outgoing lane."""

    origin: int
    exit: int
    lanes: list[int]
    junction: int
    yields: bool


@dataclass
class Arm:
    """Where a street meets a node: its lanes (from the left) in and out, its direction seen from the node."""

    incoming: list[int]
    outgoing: list[int]
    incoming_node: str
    outgoing_node: str
    direction: float


@dataclass
class Sketch:
    """All lanes, movements and junctions laid so far."""

    lane_width: float
    lanes: list[SketchedLane] = field(default_factory=list)
    movements: list[SketchedMovement] = field(default_factory=list)
    junctions: list[tuple[str, str]] = field(default_factory=list)
    _parallel: dict[tuple[str, str], int] = field(default_factory=dict)

    def new_junction(self, name: str, kind: str) -> int:
        """Return the number of a new junction."""
        self.junctions.append((name, kind))
        return len(self.junctions) - 1

    def add(self, piece: Piece, nodes: tuple[str, str], identifier: int, speed_limit: float) -> int:
        """Add an ordinary lane and return its row."""
        self.lanes.append(SketchedLane(piece, nodes, identifier, speed_limit))
        return len(self.lanes) - 1

    def add_movement(
        self, pieces: list[Piece], origin: int, exit: int, *, junction: int, turn: int, yields: bool = False
    ) -> None:
        """Add the rows that lead from row `origin` to row `exit` and link them."""
        number = len(self.movements)
        inner = [f"{self.junctions[junction][0]}/{number}:{index}" for index in range(1, len(pieces))]
        nodes = [self.lanes[origin].nodes[1], *inner, self.lanes[exit].nodes[0]]
        rows = []
        for index, piece in enumerate(pieces):
            edge = (nodes[index], nodes[index + 1])
            identifier = self._parallel.get(edge, 0)
            self._parallel[edge] = identifier + 1
            speed_limit = min(self.lanes[origin].speed_limit, self.lanes[exit].speed_limit)
            row = self.add(piece, edge, identifier, speed_limit)
            lane = self.lanes[row]
            lane.junction, lane.turn, lane.movement = junction, turn, number
            rows.append(row)
        chain = [origin, *rows, exit]
        for row, following in itertools.pairwise(chain):
            self.lanes[row].successors.append(following)
        self.movements.append(SketchedMovement(origin, exit, rows, junction, yields))
