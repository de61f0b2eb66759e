"""Which ways through a junction get in each other's way, from their geometry.

Two vehicles whose centre lines come closer than `CLEARANCE` cannot pass each other. Movements that start
from the same lane are no conflict: their vehicles follow each other until the ways have parted. Movements
that lead to the same lane are.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.sketch import Sketch

CLEARANCE = 3.0
"""Metres between two centre lines: a vehicle's width, what its corners sweep in a turn, and a margin."""

_SAMPLE_SPACING = 0.5


@dataclass
class MovementRelations:
    """By movement: its conflicts and its siblings (same origin), each with a distance in metres.

    With a conflict: how far a vehicle's rear must be along the conflict to be out of the way. With a sibling:
    over which distance from the origin the two share the road.
    """

    conflicts: list[list[tuple[int, float]]]
    siblings: list[list[tuple[int, float]]]


def movement_relations(sketch: Sketch) -> MovementRelations:
    """Return who meets whom in the junctions."""
    paths = [_sampled(sketch, movement.lanes) for movement in sketch.movements]
    lengths = [sum(sketch.lanes[row].piece.length for row in movement.lanes) for movement in sketch.movements]
    relations = MovementRelations([[] for _ in paths], [[] for _ in paths])
    for a, first in enumerate(sketch.movements):
        for b, second in enumerate(sketch.movements):
            if a == b or first.junction != second.junction:
                continue
            if first.origin == second.origin:
                relations.siblings[a].append((b, _shared_until(paths[a], paths[b], lengths[a])))
            elif first.exit == second.exit:
                relations.conflicts[a].append((b, lengths[b]))
            elif _distances(paths[a], paths[b]).min() < CLEARANCE:
                relations.conflicts[a].append((b, _shared_until(paths[b], paths[a], lengths[b])))
    return relations


def _sampled(sketch: Sketch, rows: list[int]) -> NDArray[np.float64]:
    """Return points [n, 2] along a chain of rows."""
    points = []
    for row in rows:
        piece = sketch.lanes[row].piece
        count = max(2, int(np.ceil(piece.length / _SAMPLE_SPACING)) + 1)
        points += [(pose.x, pose.y) for pose in map(piece.at, np.linspace(0.0, piece.length, count))]
    return np.array(points)


def _distances(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(first[:, None] - second[None], axis=2)


def _shared_until(path: NDArray[np.float64], other: NDArray[np.float64], length: float) -> float:
    """Return how far along a path (m, of its `length`) the last point is that is close to the other."""
    close = np.flatnonzero(_distances(path, other).min(axis=1) < CLEARANCE)
    return length * min(1.0, (close[-1] + 1) / (len(path) - 1))
