"""highway-env's road networks as arrays."""

from __future__ import annotations

import copy
import math
from collections import OrderedDict
from typing import Any

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, SineLane
from highway_env.road.road import LaneIndex, RoadNetwork

from athrl_accelerate import lanes as column
from athrl_accelerate.columns import Floats, Integers
from athrl_accelerate.grid import closest_lane_grid
from athrl_accelerate.lanes import Network
from athrl_accelerate.supported_classes import lane_class

KEPT_NETWORKS = 16
"""Number of networks that are cached: many environments make an equal network at every reset."""

_kept: OrderedDict[bytes, Network] = OrderedDict()


class CompiledNetwork:
    """The lanes of a road network as they were when this was made.

    Raises `UnknownClassError` for lanes that the kernels do not know.
    """

    def __init__(self, network: RoadNetwork) -> None:
        self.indices: list[LaneIndex] = []
        """Row of the arrays -> index in the network."""
        self.lanes: list[AbstractLane] = []
        nodes: dict[Any, int] = {origin: number for number, origin in enumerate(network.graph)}
        roads: list[tuple[int, int, int, int]] = []
        node_roads: list[tuple[int, int]] = []
        for origin, destinations in network.graph.items():
            node_roads.append((len(roads), len(destinations)))
            for destination, lanes in destinations.items():
                node = nodes.setdefault(destination, len(nodes))
                roads.append((len(self.lanes), len(lanes), nodes[origin], node))
                self.indices += [(origin, destination, number) for number in range(len(lanes))]
                self.lanes += lanes
        node_roads += [(0, 0)] * (len(nodes) - len(node_roads))
        self.nodes = nodes
        self.rows = {index: row for row, index in enumerate(self.indices)}
        self._row_of_lane = {id(lane): row for row, lane in enumerate(self.lanes)}
        self.lane_count = {(roads[i][2], roads[i][3]): roads[i][1] for i in range(len(roads))}
        numbers = np.array([_lane_numbers(lane) for lane in self.lanes]).reshape(-1, column.LANE_COLUMNS)
        self.arrays = _arrays(
            numbers, np.array(roads, np.int64).reshape(-1, 4), np.array(node_roads, np.int64)
        )

    def __deepcopy__(self, memo: dict) -> CompiledNetwork:
        twin = CompiledNetwork.__new__(CompiledNetwork)
        twin.__dict__.update(self.__dict__)  # the arrays are never written
        memo[id(self)] = twin
        twin.lanes = copy.deepcopy(self.lanes, memo)
        twin._row_of_lane = {id(lane): row for row, lane in enumerate(twin.lanes)}
        return twin

    def __getstate__(self) -> dict[str, Any]:
        """Return what the arrays are made from, and not what is found by the identity of lanes."""
        arrays = self.arrays
        made_from = arrays.lanes, arrays.roads, arrays.node_roads
        return {**self.__dict__, "arrays": made_from, "_row_of_lane": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the arrays again, or take those of an equal network; a pickle's may be read only."""
        self.__dict__.update(state)
        self.arrays = _arrays(*map(np.array, state["arrays"]))
        self._row_of_lane = {id(lane): row for row, lane in enumerate(self.lanes)}

    def row(self, index: LaneIndex) -> int:
        """Return the row of a lane index; its number may also count from the end or be None.

        Raises `ValueError` that names an index which the network does not have.
        """
        row = self.rows.get(index)
        if row is not None:
            return row
        origin, destination, number = index
        count = self.lane_count.get((self.nodes.get(origin, -1), self.nodes.get(destination, -1)), 0)
        if number is None and count == 1:
            number = 0
        if number is None or not -count <= number < count:
            raise ValueError(f"lane index is {index!r}, but the road network has no such lane")
        return self.rows[origin, destination, int(number) % count]

    def row_of(self, lane: AbstractLane) -> int:
        """Return the row of a lane of the network. Raises `ValueError` for another lane."""
        row = self._row_of_lane.get(id(lane))
        if row is None:
            raise ValueError(f"lane is {lane!r}, but the road network has no such lane")
        return row


def _lane_numbers(lane: AbstractLane) -> list[float]:
    kind = lane_class(lane)
    numbers = [0.0] * column.LANE_COLUMNS
    numbers[column.LANE_LENGTH] = float(lane.length)
    numbers[column.LANE_WIDTH] = float(lane.width)
    numbers[column.SPEED_LIMIT] = math.nan if lane.speed_limit is None else float(lane.speed_limit)
    numbers[column.PRIORITY] = float(lane.priority)
    numbers[column.FORBIDDEN] = float(bool(lane.forbidden))
    numbers[column.VEHICLE_LENGTH] = float(lane.VEHICLE_LENGTH)
    if kind is CircularLane:
        numbers[column.SHAPE] = column.CIRCULAR
        numbers[column.ORIGIN_X], numbers[column.ORIGIN_Y] = map(float, lane.center)
        numbers[column.RADIUS] = float(lane.radius)
        numbers[column.START_PHASE] = float(lane.start_phase)
        numbers[column.TURN] = float(lane.direction)
        return numbers
    numbers[column.SHAPE] = column.STRAIGHT
    numbers[column.ORIGIN_X], numbers[column.ORIGIN_Y] = map(float, lane.start)
    numbers[column.DIRECTION_X], numbers[column.DIRECTION_Y] = map(float, lane.direction)
    numbers[column.LANE_HEADING] = float(lane.heading)
    if kind is SineLane:
        numbers[column.SHAPE] = column.SINE
        numbers[column.AMPLITUDE] = float(lane.amplitude)
        numbers[column.PULSATION] = float(lane.pulsation)
        numbers[column.PHASE] = float(lane.phase)
    return numbers


def _arrays(numbers: Floats, roads: Integers, node_roads: Integers) -> Network:
    key = b"".join((numbers.tobytes(), roads.tobytes(), node_roads.tobytes()))
    if key in _kept:
        _kept.move_to_end(key)
        return _kept[key]
    lane_road = np.repeat(np.arange(len(roads)), roads[:, column.LANE_COUNT])
    network = Network(
        numbers,
        lane_road,
        roads,
        node_roads,
        *closest_lane_grid(numbers),
        *_connected(numbers, roads, lane_road),
    )
    _kept[key] = network
    if len(_kept) > KEPT_NETWORKS:
        _kept.popitem(last=False)
    return network


def _connected(numbers: Floats, roads: Integers, lane_road: Integers) -> tuple[Integers, Integers, Floats]:
    """Return the lanes after and before each lane, as `Road.neighbour_vehicles` goes through them."""
    leaving: dict[int, list[int]] = {}
    arriving: dict[int, list[int]] = {}
    for road, (_, _, origin, destination) in enumerate(roads.tolist()):
        leaving.setdefault(origin, []).append(road)
        arriving.setdefault(destination, []).append(road)
    start, lanes, offsets = [0], [], []
    for lane, own_road in enumerate(lane_road.tolist()):
        first, _, origin, destination = roads[own_road].tolist()
        for road in leaving.get(destination, ()):
            lanes.append(_same_or_first(roads, road, lane - first))
            offsets.append(numbers[lane, column.LANE_LENGTH])
        for road in arriving.get(origin, ()):
            lanes.append(_same_or_first(roads, road, lane - first))
            offsets.append(-numbers[lanes[-1], column.LANE_LENGTH])
        start.append(len(lanes))
    return np.array(start, np.int64), np.array(lanes, np.int64), np.array(offsets, np.float64)


def _same_or_first(roads: Integers, road: int, number: int) -> int:
    first, count = roads[road, column.FIRST_LANE], roads[road, column.LANE_COUNT]
    return int(first + number if number < count else first)
