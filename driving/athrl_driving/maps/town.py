"""A town, ready to be driven in, and the towns by name."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.builder import sketch_town
from athrl_driving.maps.conflicts import MovementRelations, movement_relations
from athrl_driving.maps.description import TownDescription
from athrl_driving.maps.lane_graph import LaneGraph, Movements, Signals, no_signals
from athrl_driving.maps.network import TownNetwork, build_network, graph_heading
from athrl_driving.maps.sketch import Sketch
from athrl_driving.maps.town03 import TOWN03

TOWNS: dict[str, TownDescription] = {"town03": TOWN03}
"""The towns that the project ships."""


@dataclass(frozen=True)
class Junction:
    """A junction's place name and kind: "T-junction", "crossing" or "roundabout" (one of its arms)."""

    name: str
    kind: str


@dataclass(frozen=True)
class Town:
    """A town: highway-env's network and the arrays are two views of the same lanes."""

    name: str
    network: TownNetwork
    graph: LaneGraph
    movements: Movements
    signals: Signals
    lane_indices: list[tuple[str, str, int]]
    """Row of the graph -> highway-env's lane index; several rows may share one."""
    road_name: tuple[str, ...]
    """Row of the graph -> the name of its road in the map's file."""
    lane_id: NDArray[np.int64]
    """Row of the graph -> its lane's id on that road."""
    junctions: tuple[Junction, ...]
    """By junction number."""

    def lane_polylines(self, spacing: float = 2.0) -> list[NDArray[np.float64]]:
        """Return the centre line of every lane as points [n, 2] in metres, at most `spacing` metres apart."""
        lines = []
        for index in self.lane_indices:
            lane = self.network.get_lane(index)
            count = 2 if lane.length <= spacing else int(np.ceil(lane.length / spacing)) + 1
            lines.append(np.array([lane.position(s, 0.0) for s in np.linspace(0.0, lane.length, count)]))
        return lines


@cache
def load_town(name: str) -> Town:
    """Return a town, built once a process. Raises `ValueError` that names the towns there are."""
    if name not in TOWNS:
        raise ValueError(f"there is no town named {name!r}; choose one of: {', '.join(sorted(TOWNS))}")
    return build_town(TOWNS[name])


def build_town(description: TownDescription) -> Town:
    """Build a town. Raises `ValueError` that names the street or the node that cannot be built."""
    sketch = sketch_town(description)
    relations = movement_relations(sketch)
    graph = _graph(sketch)
    network, indices = build_network(sketch, graph)
    junctions = tuple(Junction(*junction) for junction in sketch.junctions)
    return Town(
        name=description.name,
        network=network,
        graph=graph,
        movements=_movements(sketch, relations),
        signals=no_signals(),
        lane_indices=indices,
        road_name=tuple("-".join(lane.nodes) for lane in sketch.lanes),
        lane_id=np.array([-1 - lane.identifier for lane in sketch.lanes], dtype=np.int64),
        junctions=junctions,
    )


def _compressed(lists: list[list[int]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    starts = np.concatenate([[0], np.cumsum([len(values) for values in lists])]).astype(np.int64)
    return starts, np.array([value for values in lists for value in values], dtype=np.int64)


def _graph(sketch: Sketch) -> LaneGraph:
    lanes = sketch.lanes

    def floats(values: list[float]) -> NDArray[np.float64]:
        return np.array(values, dtype=np.float64)

    def integers(values: list[int]) -> NDArray[np.int64]:
        return np.array(values, dtype=np.int64)

    successor_start, successor = _compressed([lane.successors for lane in lanes])
    headings = floats([graph_heading(lane.piece.start.heading) for lane in lanes])
    offsets = np.zeros(len(lanes))
    for movement in sketch.movements:
        lengths = [lanes[row].piece.length for row in movement.lanes]
        offsets[movement.lanes] = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    return LaneGraph(
        curvature=floats([lane.piece.curvature for lane in lanes]),
        start_x=floats([lane.piece.start.x for lane in lanes]),
        start_y=floats([lane.piece.start.y for lane in lanes]),
        start_heading=headings,
        length=floats([lane.piece.length for lane in lanes]),
        width=np.full(len(lanes), sketch.lane_width),
        elevation=np.zeros(len(lanes)),
        grade=np.zeros(len(lanes)),
        speed_limit=floats([lane.speed_limit for lane in lanes]),
        successor_start=successor_start,
        successor=successor,
        dead_end=np.array([not lane.successors for lane in lanes]),
        junction=integers([lane.junction for lane in lanes]),
        turn=integers([lane.turn for lane in lanes]),
        left=integers([lane.left for lane in lanes]),
        right=integers([lane.right for lane in lanes]),
        start_cos=np.cos(headings),
        start_sin=np.sin(headings),
        box=_boxes(sketch),
        movement=integers([lane.movement for lane in lanes]),
        movement_offset=offsets,
    )


def _boxes(sketch: Sketch) -> NDArray[np.float64]:
    boxes = np.empty((len(sketch.lanes), 4))
    for row, lane in enumerate(sketch.lanes):
        poses = [lane.piece.at(s) for s in np.linspace(0.0, lane.piece.length, 17)]
        points = np.array([(pose.x, pose.y) for pose in poses])
        # Between two samples an arc bulges by up to (step/2)^2 / (2 radius).
        bulge = abs(lane.piece.curvature) * (lane.piece.length / 16.0) ** 2 / 8.0
        boxes[row, :2] = points.min(axis=0) - sketch.lane_width / 2.0 - bulge
        boxes[row, 2:] = points.max(axis=0) + sketch.lane_width / 2.0 + bulge
    return boxes


def _movements(sketch: Sketch, relations: MovementRelations) -> Movements:
    lane_start, lane = _compressed([movement.lanes for movement in sketch.movements])
    conflict_start, conflict = _compressed([[other for other, _ in pairs] for pairs in relations.conflicts])
    sibling_start, sibling = _compressed([[other for other, _ in pairs] for pairs in relations.siblings])
    lengths = [sum(sketch.lanes[row].piece.length for row in movement.lanes) for movement in sketch.movements]
    return Movements(
        origin=np.array([movement.origin for movement in sketch.movements], dtype=np.int64),
        exit=np.array([movement.exit for movement in sketch.movements], dtype=np.int64),
        length=np.array(lengths),
        yields=np.array([movement.yields for movement in sketch.movements]),
        priority=np.array([int(movement.yields) for movement in sketch.movements], dtype=np.int64),
        signal=np.full(len(sketch.movements), -1),
        lane_start=lane_start,
        lane=lane,
        conflict_start=conflict_start,
        conflict=conflict,
        release=np.array([length for pairs in relations.conflicts for _, length in pairs]),
        sibling_start=sibling_start,
        sibling=sibling,
        shared=np.array([length for pairs in relations.siblings for _, length in pairs]),
    )
