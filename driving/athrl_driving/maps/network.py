"""The same lanes as highway-env's road network, for its renderer and its vehicles."""

import math

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, LineType, StraightLane
from highway_env.road.road import LaneIndex, RoadNetwork
from numpy.typing import NDArray

from athrl_driving.maps.geometry import closest_lane
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.maps.sketch import Sketch, SketchedLane


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


def build_network(sketch: Sketch, graph: LaneGraph) -> tuple[TownNetwork, list[LaneIndex]]:
    """Return the network and the lane index of every row of the graph."""
    indices: list[LaneIndex] = [(*lane.nodes, lane.identifier) for lane in sketch.lanes]
    network = TownNetwork(graph, indices)
    for row in sorted(range(len(sketch.lanes)), key=lambda row: sketch.lanes[row].identifier):
        lane = sketch.lanes[row]
        network.add_lane(*lane.nodes, _highway_lane(lane, sketch.lane_width))
    return network, indices


def _line_types(lane: SketchedLane) -> tuple[int, int]:
    if lane.movement >= 0:
        return LineType.NONE, LineType.NONE
    left = LineType.CONTINUOUS if lane.left < 0 else LineType.STRIPED
    right = LineType.CONTINUOUS if lane.right < 0 else LineType.NONE
    return left, right


def _highway_lane(lane: SketchedLane, width: float) -> AbstractLane:
    start, curvature = lane.piece.start, lane.piece.curvature
    looks = {"width": width, "line_types": _line_types(lane), "speed_limit": lane.speed_limit}
    if curvature == 0.0:
        end = lane.piece.end
        return StraightLane((start.x, start.y), (end.x, end.y), **looks)
    radius = 1.0 / curvature
    centre = start.beside(radius)
    clockwise = curvature > 0.0
    quarter = math.pi / 2.0 if clockwise else -math.pi / 2.0
    heading = graph_heading(start.heading)
    return CircularLane(
        (centre.x, centre.y),
        abs(radius),
        start_phase=heading - quarter,
        end_phase=heading + curvature * lane.piece.length - quarter,
        clockwise=clockwise,
        **looks,
    )


def graph_heading(heading: float) -> float:
    """Return a heading as the lane graph stores it: within (-pi, pi], and exactly -pi never."""
    return math.atan2(math.sin(heading), math.cos(heading))
