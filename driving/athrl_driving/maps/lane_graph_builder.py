"""Builds the arrays that kernels read from ordinary segments and movements."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.compressed_lists import compressed
from athrl_driving.maps.conflicts import Relations
from athrl_driving.maps.grid import lane_boxes, lane_grid
from athrl_driving.maps.lane_graph import TURN_STRAIGHT, Floats, Integers, LaneGraph, Movements
from athrl_driving.maps.opendrive.carriageways import LaneSegment
from athrl_driving.maps.reachability import Drivable


@dataclass(frozen=True, slots=True)
class LaneNumbering:
    """The lanes of the graph: first the ordinary segments, then those of every movement, copied for each."""

    segments: list[LaneSegment]
    """By lane: its segment."""
    movement_lanes: list[range]
    """By movement: its lanes."""
    ordinary: dict[LaneSegment, int]
    """By ordinary segment: its lane."""


def number_lanes(drivable: Drivable) -> LaneNumbering:
    """Number the lanes in order."""
    segments = list(drivable.segments)
    ordinary = {segment: lane for lane, segment in enumerate(segments)}
    movement_lanes = []
    for movement in drivable.movements:
        movement_lanes.append(range(len(segments), len(segments) + len(movement.segments)))
        segments += movement.segments
    return LaneNumbering(segments, movement_lanes, ordinary)


def build_graph(
    drivable: Drivable, numbering: LaneNumbering, junction: Integers, turns: Integers
) -> LaneGraph:
    """Return the lane graph; `junction` and `turns` are those of the movements [M]."""
    count = len(numbering.segments)

    def column(name: str) -> Floats:
        return np.array([getattr(segment, name) for segment in numbering.segments], dtype=np.float64)

    length, width = column("length"), column("width")
    heading = column("heading")
    heading = np.arctan2(np.sin(heading), np.cos(heading))
    lists = _successors(drivable, numbering)
    successor_start, successor = compressed(lists)
    leaves = _among(drivable.leaves, numbering)
    movement, offset = np.full(count, -1, dtype=np.int64), np.zeros(count)
    lane_junction, turn = np.full(count, -1, dtype=np.int64), np.full(count, TURN_STRAIGHT, dtype=np.int64)
    for number, own in enumerate(numbering.movement_lanes):
        block = slice(own.start, own.stop)
        movement[block], lane_junction[block], turn[block] = number, junction[number], turns[number]
        offset[block] = np.concatenate([[0.0], np.cumsum(length[block])[:-1]])
    lines = (column("x"), column("y"), heading, column("curvature"), length)
    box = lane_boxes(*lines, width)
    return LaneGraph(
        curvature=lines[3],
        start_x=lines[0],
        start_y=lines[1],
        start_heading=heading,
        length=length,
        width=width,
        elevation=column("elevation"),
        grade=(column("end_elevation") - column("elevation")) / length,
        speed_limit=column("limit"),
        successor_start=successor_start,
        successor=successor,
        dead_end=np.array([not targets for targets in lists], dtype=np.bool_) & ~leaves,
        enters=_among(drivable.enters, numbering),
        leaves=leaves,
        junction=lane_junction,
        turn=turn,
        left=_neighbours(drivable.left, numbering),
        right=_neighbours(drivable.right, numbering),
        start_cos=np.cos(heading),
        start_sin=np.sin(heading),
        box=box,
        movement=movement,
        movement_offset=offset,
        **lane_grid(box),
    )


def _successors(drivable: Drivable, numbering: LaneNumbering) -> list[list[int]]:
    lists: list[list[int]] = [[] for _ in numbering.segments]
    for segment, lane in numbering.ordinary.items():
        lists[lane] = [numbering.ordinary[after] for after in drivable.ahead[segment]]
    for movement, own in zip(drivable.movements, numbering.movement_lanes, strict=True):
        chain = [numbering.ordinary[movement.origin], *own, numbering.ordinary[movement.exit]]
        for lane, after in itertools.pairwise(chain):
            lists[lane].append(after)
    return lists


def _among(chosen: set[LaneSegment], numbering: LaneNumbering) -> NDArray[np.bool_]:
    """Return which lanes are ordinary and `chosen`, [L]."""
    result = np.zeros(len(numbering.segments), dtype=np.bool_)
    result[[numbering.ordinary[segment] for segment in chosen]] = True
    return result


def _neighbours(beside: dict[LaneSegment, LaneSegment], numbering: LaneNumbering) -> Integers:
    result = np.full(len(numbering.segments), -1, dtype=np.int64)
    for segment, other in beside.items():
        result[numbering.ordinary[segment]] = numbering.ordinary[other]
    return result


def build_movements(
    drivable: Drivable,
    numbering: LaneNumbering,
    relations: Relations,
    yields: NDArray[np.bool_],
    priority: Integers,
    signal: Integers,
) -> Movements:
    """Return the movements as arrays."""
    movements = drivable.movements
    count = len(movements)
    lane_start, lane = compressed([list(own) for own in numbering.movement_lanes])
    return Movements(
        origin=np.array([numbering.ordinary[movement.origin] for movement in movements], dtype=np.int64),
        exit=np.array([numbering.ordinary[movement.exit] for movement in movements], dtype=np.int64),
        length=np.array([movement.length for movement in movements], dtype=np.float64),
        yields=yields,
        priority=priority,
        signal=signal,
        lane_start=lane_start,
        lane=lane,
        conflict_start=_starts(relations.conflicts, count),
        conflict=np.ascontiguousarray(relations.conflicts[:, 1]),
        release=relations.release,
        sibling_start=_starts(relations.siblings, count),
        sibling=np.ascontiguousarray(relations.siblings[:, 1]),
        shared=relations.shared,
    )


def _starts(pairs: Integers, count: int) -> Integers:
    return np.searchsorted(pairs[:, 0], np.arange(count + 1)).astype(np.int64)
