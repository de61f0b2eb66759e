"""Conflict zones: where conflicting movements first come close to each other, and where they merge.

Of two vehicles on conflicting movements, the later one may drive up to the zone's start. Where movements
merge, as all do in a roundabout, a vehicle on the common lane is a leader for those that come to it, not an
obstacle.
"""

from typing import NamedTuple

import numpy as np

from athrl_driving.maps import Town, lane_pose
from athrl_driving.maps.lane_graph import Floats, Integers

_DIVERGING_WITHIN = 15.0
"""Metres behind a common lane within which movements still diverge; beyond, they conflict once more."""

_SPACING = 1.0
_MOST_PAIRS = 500_000
"""Pairs of points that are compared at a time: movements may be kilometres long."""
_NEAR = 3.2
"""Metres between centre lines that count as a conflict: the map's clearance plus a sampling margin."""


class ConflictZones(NamedTuple):
    """Pairs of conflicting movements: C conflicts as in `Movements.conflict`, and those that merge."""

    begin: Floats
    """[C] m along the movement to where it first comes close to the conflict."""
    clear: Floats
    """[C] m along the conflict beyond which its vehicles are out of the way, or leaders."""
    merge_start: Integers
    """[M+1] merges with `m` are at `merge_start[m]:merge_start[m + 1]` of the arrays that follow."""
    merged: Integers
    """[..] the movement that it merges with."""
    merged_begin: Floats
    """[..] m along the other movement to where the common lane begins."""
    merged_until: Floats
    """[..] m along the other movement beyond which a vehicle's rear has diverged."""
    merged_shift: Floats
    """[..] m to add to a position on the other movement for the position on the movement."""


def conflict_zones_of(town: Town) -> ConflictZones:
    """Return the conflict zones and merges of a town."""
    movements = town.movements
    shapes = [_MovementShape(town, movement) for movement in range(len(movements.length))]
    begin, clear = np.zeros(len(movements.conflict)), movements.release.copy()
    starts, merged = [0], []
    for movement, shape in enumerate(shapes):
        for index in range(movements.conflict_start[movement], movements.conflict_start[movement + 1]):
            other, release = int(movements.conflict[index]), float(movements.release[index])
            begin[index] = shape.first_conflict(shapes[other])
            common = shape.common_lane(shapes[other], release)
            if common is not None:
                merged.append((other, common[1], release, common[0] - common[1]))
                clear[index] = min(release, common[1])
        starts.append(len(merged))
    others, begins, untils, shifts = np.array(merged, dtype=np.float64).reshape(-1, 4).T.copy()
    merge_start = np.array(starts, dtype=np.int64)
    return ConflictZones(begin, clear, merge_start, others.astype(np.int64), begins, untils, shifts)


class _MovementShape:
    """A movement as points and as a chain of lanes; copies of a lane count as one lane."""

    def __init__(self, town: Town, movement: int) -> None:
        movements, graph = town.movements, town.graph
        lanes = movements.lane[movements.lane_start[movement] : movements.lane_start[movement + 1]]
        self.lanes = [town.lane_indices[lane] for lane in lanes]
        self.ends = np.cumsum(graph.length[lanes])
        self.place = {index: place for place, index in enumerate(self.lanes)}
        points, along = [], []
        for lane, end in zip(lanes, self.ends, strict=True):
            length = float(graph.length[lane])
            stations = np.linspace(0.0, length, max(2, int(np.ceil(length / _SPACING)) + 1))
            points += [lane_pose(graph, lane, s)[:2] for s in stations]
            along += (end - length + stations).tolist()
        self.points, self.along = np.array(points), np.array(along)

    def first_conflict(self, other: "_MovementShape") -> float:
        """Return m along this movement to the first point that is close to the other movement."""
        step = max(1, _MOST_PAIRS // len(other.points))
        for begin in range(0, len(self.points), step):
            apart = self.points[begin : begin + step, None] - other.points[None]
            near = ((apart * apart).sum(axis=2) < _NEAR * _NEAR).any(axis=1)
            if near.any():
                return float(self.along[begin + np.argmax(near)])
        return 0.0

    def common_lane(self, other: "_MovementShape", release: float) -> tuple[float, float] | None:
        """Return m along both to where their last common lanes begin; None if they conflict again behind."""
        shared = [place for place, index in enumerate(other.lanes) if index in self.place]
        if not shared or other.ends[shared[-1]] + _DIVERGING_WITHIN < release:
            return None
        first, own = shared[-1], self.place[other.lanes[shared[-1]]]
        while first > 0 and own > 0 and other.lanes[first - 1] == self.lanes[own - 1]:
            first, own = first - 1, own - 1
        return (
            float(self.ends[own - 1]) if own > 0 else 0.0,
            float(other.ends[first - 1]) if first > 0 else 0.0,
        )
