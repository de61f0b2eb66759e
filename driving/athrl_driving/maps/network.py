"""The same lanes as highway-env's road network, for its renderer and its vehicles.

An edge of the network is a carriageway: the lanes of one direction between two stations of a road, from
the left to the right, so that highway-env's vehicles change lanes on it. Nodes join what lane links join.
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

from athrl_driving.maps.disjoint_sets import DisjointSets
from athrl_driving.maps.geometry import closest_lane
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.maps.lane_graph_builder import LaneNumbering
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
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
        lane = closest_lane(self.lane_graph, float(position[0]), float(position[1]), float(heading))
        return self.lane_indices[lane]

    def shortest_path(self, start: str, goal: str) -> list[str]:
        """Return the nodes of the shortest path in metres; empty where there is none, or none is needed.

        highway-env's own search tries every path without a loop, which takes far too long in a town.
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


def build_network(
    drivable: Drivable, numbering: LaneNumbering, graph: LaneGraph
) -> tuple[TownNetwork, list[LaneIndex]]:
    """Return the network and highway-env's index of every lane of the graph; copies of a lane share one."""
    carriageways: dict[Carriageway, list[LaneSegment]] = defaultdict(list)
    for segment in dict.fromkeys(numbering.segments):
        carriageways[segment.carriageway].append(segment)
    nodes = _name_nodes(drivable, carriageways)
    edges: dict[tuple[str, str], list[LaneSegment]] = defaultdict(list)
    for carriageway, segments in carriageways.items():
        edges[nodes[carriageway]] += sorted(segments, key=carriageway.lanes.index)
    index_of: dict[LaneSegment, LaneIndex] = {}
    for (start, end), segments in edges.items():
        if len({segment.carriageway for segment in segments}) > 1:
            segments.sort(key=partial(_place_from_left, segments[0]))
        for identifier, segment in enumerate(segments):
            index_of[segment] = (start, end, identifier)
    indices = [index_of[segment] for segment in numbering.segments]
    network = TownNetwork(graph, indices)
    lane_of = {segment: lane for lane, segment in reversed(list(enumerate(numbering.segments)))}
    for (start, end), segments in edges.items():
        for segment in segments:
            network.add_lane(start, end, _highway_lane(segment, graph, lane_of[segment]))
    return network, indices


def _name_nodes(
    drivable: Drivable, carriageways: dict[Carriageway, list[LaneSegment]]
) -> dict[Carriageway, tuple[str, str]]:
    """Return every carriageway's start and end node."""
    number = {carriageway: place for place, carriageway in enumerate(carriageways)}
    joined = DisjointSets(range(2 * len(number)))
    chains = [[movement.origin, *movement.segments, movement.exit] for movement in drivable.movements]
    chains += [[segment, after] for segment in drivable.segments for after in drivable.ahead[segment]]
    for chain in chains:
        for before, after in itertools.pairwise(chain):
            joined.join(2 * number[after.carriageway], 2 * number[before.carriageway] + 1)
    names: dict[int, str] = {}
    for carriageway, place in number.items():
        # A node is named after the first carriageway that starts or ends there.
        label = f"road {carriageway.road.id} {'forth' if carriageway.forward else 'back'}"
        names.setdefault(
            joined.root(2 * place),
            f"{label} {carriageway.start if carriageway.forward else carriageway.end:.2f}",
        )
        names.setdefault(
            joined.root(2 * place + 1),
            f"{label} {carriageway.end if carriageway.forward else carriageway.start:.2f}",
        )
    return {
        carriageway: (names[joined.root(2 * place)], names[joined.root(2 * place + 1)])
        for carriageway, place in number.items()
    }


def _place_from_left(reference: LaneSegment, segment: LaneSegment) -> float:
    """Return how far to the right of `reference` a segment's middle lies (m)."""
    x, y, heading = reference.at(0.5 * reference.length)
    segment_x, segment_y, _ = segment.at(0.5 * segment.length)
    return (segment_y - y) * math.cos(heading) - (segment_x - x) * math.sin(heading)


def _line_types(graph: LaneGraph, lane: int) -> tuple[int, int]:
    if graph.movement[lane] >= 0:
        return LineType.NONE, LineType.NONE
    left = LineType.CONTINUOUS if graph.left[lane] < 0 else LineType.STRIPED
    right = LineType.CONTINUOUS if graph.right[lane] < 0 else LineType.NONE
    return left, right


def _highway_lane(segment: LaneSegment, graph: LaneGraph, lane: int) -> AbstractLane:
    curvature = float(graph.curvature[lane])
    heading, length = float(graph.start_heading[lane]), float(graph.length[lane])
    x, y = float(graph.start_x[lane]), float(graph.start_y[lane])
    looks = {
        "width": segment.width,
        "line_types": _line_types(graph, lane),
        "speed_limit": segment.limit,
        # Lane changes are allowed on ordinary road, and forbidden between movements through a junction.
        "forbidden": graph.movement[lane] >= 0,
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
