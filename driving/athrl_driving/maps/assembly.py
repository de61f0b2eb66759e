"""From stretches and ways to the arrays that kernels read."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.conflicts import Relations
from athrl_driving.maps.grid import lane_boxes, lane_grid
from athrl_driving.maps.lane_graph import TURN_STRAIGHT, Floats, Integers, LaneGraph, Movements
from athrl_driving.maps.opendrive.strips import LanePiece
from athrl_driving.maps.reachability import Drivable


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows of the lane graph: first the ordinary pieces, then those of every way, copied for each."""

    pieces: list[LanePiece]
    ways: list[range]
    """By way: its rows."""
    ordinary: dict[LanePiece, int]


def number_rows(drivable: Drivable) -> Rows:
    """Return the rows in order."""
    pieces = list(drivable.pieces)
    ordinary = {piece: row for row, piece in enumerate(pieces)}
    ways = []
    for way in drivable.ways:
        ways.append(range(len(pieces), len(pieces) + len(way.pieces)))
        pieces += way.pieces
    return Rows(pieces, ways, ordinary)


def compressed(lists: list[list[int]]) -> tuple[Integers, Integers]:
    """Return lists of variable length as (start [n+1], values)."""
    starts = np.concatenate([[0], np.cumsum([len(values) for values in lists])]).astype(np.int64)
    return starts, np.array([value for values in lists for value in values], dtype=np.int64)


def build_graph(drivable: Drivable, rows: Rows, junction: Integers, turns: Integers) -> LaneGraph:
    """Return the lane graph; `junction` and `turns` are those of the ways [M]."""
    count = len(rows.pieces)

    def column(name: str) -> Floats:
        return np.array([getattr(piece, name) for piece in rows.pieces], dtype=np.float64)

    length, width = column("length"), column("width")
    heading = column("heading")
    heading = np.arctan2(np.sin(heading), np.cos(heading))
    lists = _successors(drivable, rows)
    successor_start, successor = compressed(lists)
    movement, offset = np.full(count, -1, dtype=np.int64), np.zeros(count)
    row_junction, turn = np.full(count, -1, dtype=np.int64), np.full(count, TURN_STRAIGHT, dtype=np.int64)
    for number, own in enumerate(rows.ways):
        block = slice(own.start, own.stop)
        movement[block], row_junction[block], turn[block] = number, junction[number], turns[number]
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
        dead_end=np.array([not targets for targets in lists], dtype=np.bool_),
        junction=row_junction,
        turn=turn,
        left=_neighbours(drivable.left, rows),
        right=_neighbours(drivable.right, rows),
        start_cos=np.cos(heading),
        start_sin=np.sin(heading),
        box=box,
        movement=movement,
        movement_offset=offset,
        **lane_grid(box),
    )


def _successors(drivable: Drivable, rows: Rows) -> list[list[int]]:
    lists: list[list[int]] = [[] for _ in rows.pieces]
    for piece, row in rows.ordinary.items():
        lists[row] = [rows.ordinary[after] for after in piece.successors if after in rows.ordinary]
    for way, own in zip(drivable.ways, rows.ways, strict=True):
        chain = [rows.ordinary[way.origin], *own, rows.ordinary[way.exit]]
        for row, after in itertools.pairwise(chain):
            lists[row].append(after)
    return lists


def _neighbours(beside: dict[LanePiece, LanePiece], rows: Rows) -> Integers:
    result = np.full(len(rows.pieces), -1, dtype=np.int64)
    for piece, other in beside.items():
        result[rows.ordinary[piece]] = rows.ordinary[other]
    return result


def build_movements(
    drivable: Drivable,
    rows: Rows,
    relations: Relations,
    yields: NDArray[np.bool_],
    priority: Integers,
    signal: Integers,
) -> Movements:
    """Return the ways as arrays."""
    ways = drivable.ways
    count = len(ways)
    lane_start, lane = compressed([list(own) for own in rows.ways])
    return Movements(
        origin=np.array([rows.ordinary[way.origin] for way in ways], dtype=np.int64),
        exit=np.array([rows.ordinary[way.exit] for way in ways], dtype=np.int64),
        length=np.array([way.length for way in ways], dtype=np.float64),
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
