"""The same lanes as highway-env's road network, for its renderer and its vehicles.

An edge of the network is a strip: the lanes of one direction between two stations of a road, from the left to
the right, so that highway-env's vehicles change lanes on it. Nodes join what lane links join.
"""

import heapq
import itertools
import math
from collections import defaultdict
from functools import partial

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, LineType, StraightLane
from highway_env.road.road import LaneIndex, RoadNetwork
from numpy.typing import NDArray

from athrl_driving.maps.assembly import Rows
from athrl_driving.maps.geometry import closest_lane
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.maps.opendrive.strips import LanePiece, Strip
from athrl_driving.maps.reachability import Drivable


class TownNetwork(RoadNetwork):
    """A `RoadNetwork` that finds the closest lane with the compiled search over the lane graph."""

    def __init__(self, lane_graph: LaneGraph, lane_indices: list[LaneIndex]) -> None:
        super().__init__()
        self.lane_graph = lane_graph
        self.lane_indices = lane_indices

    def get_closest_lane_index(
        self, position: NDArray[np.float64], heading: float | None = None
    ) -> LaneIndex:
        """Return the index of the lane closest to a position (m) and, where given, a heading (rad)."""
        if heading is None:
            return super().get_closest_lane_index(position)
        row = closest_lane(self.lane_graph, float(position[0]), float(position[1]), float(heading))
        return self.lane_indices[row]

    def shortest_path(self, start: str, goal: str) -> list[str]:
        """Return the nodes of the shortest way in metres; empty where there is none, or none is needed.

        highway-env's own search tries all ways that do not meet themselves, which takes for ever in a town.
        """
        metres, before, waiting = {start: 0.0}, {start: ""}, [(0.0, start)]
        while waiting:
            travelled, node = heapq.heappop(waiting)
            if travelled > metres[node]:
                continue
            if node == goal:
                break
            for following, lanes in self.graph.get(node, {}).items():
                total = travelled + lanes[0].length
                if total < metres.get(following, math.inf):
                    metres[following], before[following] = total, node
                    heapq.heappush(waiting, (total, following))
        if start == goal or goal not in before:
            return []
        path = [goal]
        while path[-1] != start:
            path.append(before[path[-1]])
        return path[::-1]


def build_network(drivable: Drivable, rows: Rows, graph: LaneGraph) -> tuple[TownNetwork, list[LaneIndex]]:
    """Return the network and the lane index of every row of the graph; copies of a row share one."""
    strips: dict[Strip, list[LanePiece]] = defaultdict(list)
    for piece in dict.fromkeys(rows.pieces):
        strips[piece.strip].append(piece)
    nodes = _name_nodes(drivable, strips)
    edges: dict[tuple[str, str], list[LanePiece]] = defaultdict(list)
    for strip, pieces in strips.items():
        edges[nodes[strip]] += sorted(pieces, key=strip.lanes.index)
    index_of: dict[LanePiece, LaneIndex] = {}
    for (start, end), pieces in edges.items():
        if len({piece.strip for piece in pieces}) > 1:
            pieces.sort(key=partial(_place_from_left, pieces[0]))
        for identifier, piece in enumerate(pieces):
            index_of[piece] = (start, end, identifier)
    indices = [index_of[piece] for piece in rows.pieces]
    network = TownNetwork(graph, indices)
    row_of = {piece: row for row, piece in reversed(list(enumerate(rows.pieces)))}
    for (start, end), pieces in edges.items():
        for piece in pieces:
            network.add_lane(start, end, _highway_lane(piece, graph, row_of[piece]))
    return network, indices


def _name_nodes(drivable: Drivable, strips: dict[Strip, list[LanePiece]]) -> dict[Strip, tuple[str, str]]:
    """Return every strip's start and end node."""
    number = {strip: place for place, strip in enumerate(strips)}
    parent = list(range(2 * len(number)))

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    chains = [[way.origin, *way.pieces, way.exit] for way in drivable.ways]
    ordinary = set(drivable.pieces)
    chains += [[piece, after] for piece in drivable.pieces for after in piece.successors if after in ordinary]
    for chain in chains:
        for before, after in itertools.pairwise(chain):
            parent[root(2 * number[before.strip] + 1)] = root(2 * number[after.strip])
    names: dict[int, str] = {}
    for strip, place in number.items():
        # A node is named after the first strip that starts or ends there.
        way = f"road {strip.road.id} {'forth' if strip.forward else 'back'}"
        names.setdefault(root(2 * place), f"{way} {strip.start if strip.forward else strip.end:.2f}")
        names.setdefault(root(2 * place + 1), f"{way} {strip.end if strip.forward else strip.start:.2f}")
    return {strip: (names[root(2 * place)], names[root(2 * place + 1)]) for strip, place in number.items()}


def _place_from_left(reference: LanePiece, piece: LanePiece) -> float:
    """Return how far to the right of `reference` a piece lies in its middle (m)."""
    x, y, heading = reference.at(0.5 * reference.length)
    piece_x, piece_y, _ = piece.at(0.5 * piece.length)
    return (piece_y - y) * math.cos(heading) - (piece_x - x) * math.sin(heading)


def _line_types(graph: LaneGraph, row: int) -> tuple[int, int]:
    if graph.movement[row] >= 0:
        return LineType.NONE, LineType.NONE
    left = LineType.CONTINUOUS if graph.left[row] < 0 else LineType.STRIPED
    right = LineType.CONTINUOUS if graph.right[row] < 0 else LineType.NONE
    return left, right


def _highway_lane(piece: LanePiece, graph: LaneGraph, row: int) -> AbstractLane:
    curvature = float(graph.curvature[row])
    heading, length = float(graph.start_heading[row]), float(graph.length[row])
    x, y = float(graph.start_x[row]), float(graph.start_y[row])
    looks = {
        "width": piece.width,
        "line_types": _line_types(graph, row),
        "speed_limit": piece.limit,
        # On roads beside each other one may change; between ways through a junction one may not.
        "forbidden": graph.movement[row] >= 0,
    }
    if curvature == 0.0:
        end = (x + length * math.cos(heading), y + length * math.sin(heading))
        return StraightLane((x, y), end, **looks)
    radius = 1.0 / curvature
    clockwise = curvature > 0.0
    quarter = math.pi / 2.0 if clockwise else -math.pi / 2.0
    return CircularLane(
        (x - radius * math.sin(heading), y + radius * math.cos(heading)),
        abs(radius),
        start_phase=heading - quarter,
        end_phase=heading + curvature * length - quarter,
        clockwise=clockwise,
        **looks,
    )
