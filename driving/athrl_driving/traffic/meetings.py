"""Where ways through a junction that get in each other's way begin to do so, and where they merge.

Of two vehicles that cross, the later one may come up to where its way first meets the other's. Where ways
merge, as all do in a roundabout, who is on the common lane is a leader for those who come to it, no obstacle.
"""

from typing import NamedTuple

import numpy as np

from athrl_driving.maps import Town, lane_pose
from athrl_driving.maps.lane_graph import Floats, Integers

_PARTING = 15.0
"""Metres behind a common lane within which the ways still part; beyond, they meet once more."""

_SPACING = 1.0
_NEAR = 3.2
"""Metres between centre lines that are a meeting: the map's clearance, and what lies between two points."""


class Meetings(NamedTuple):
    """Pairs of movements that meet: C conflicts as in `Movements.conflict`, and those of them that merge."""

    begin: Floats
    """[C] m along the movement where it first meets the conflict."""
    clear: Floats
    """[C] m along the conflict behind which its vehicles are out of the way, or leaders."""
    merge_start: Integers
    """[M+1] movements that merge with `m` are at `merge_start[m]:merge_start[m + 1]` of what follows."""
    merged: Integers
    """[..] the movement that it merges with."""
    merged_begin: Floats
    """[..] m along that where the common lane begins."""
    merged_until: Floats
    """[..] m along that behind which a vehicle's rear has parted."""
    merged_shift: Floats
    """[..] m to add to a place on that for the place along the movement."""


def meetings_of(town: Town) -> Meetings:
    """Return what meets and merges in a town."""
    movements = town.movements
    ways = [_Way(town, movement) for movement in range(len(movements.length))]
    begin, clear = np.zeros(len(movements.conflict)), movements.release.copy()
    starts, merged = [0], []
    for movement, way in enumerate(ways):
        for index in range(movements.conflict_start[movement], movements.conflict_start[movement + 1]):
            other, release = int(movements.conflict[index]), float(movements.release[index])
            begin[index] = way.first_meeting(ways[other])
            common = way.common_lane(ways[other], release)
            if common is not None:
                merged.append((other, common[1], release, common[0] - common[1]))
                clear[index] = min(release, common[1])
        starts.append(len(merged))
    others, begins, untils, shifts = np.array(merged, dtype=np.float64).reshape(-1, 4).T.copy()
    merge_start = np.array(starts, dtype=np.int64)
    return Meetings(begin, clear, merge_start, others.astype(np.int64), begins, untils, shifts)


class _Way:
    """A movement as points and as a chain of lanes; rows that are copies of each other are one lane."""

    def __init__(self, town: Town, movement: int) -> None:
        movements, graph = town.movements, town.graph
        rows = movements.lane[movements.lane_start[movement] : movements.lane_start[movement + 1]]
        self.lanes = [town.lane_indices[row] for row in rows]
        self.ends = np.cumsum(graph.length[rows])
        self.place = {lane: place for place, lane in enumerate(self.lanes)}
        points, along = [], []
        for row, end in zip(rows, self.ends, strict=True):
            length = float(graph.length[row])
            stations = np.linspace(0.0, length, max(2, int(np.ceil(length / _SPACING)) + 1))
            points += [lane_pose(graph, row, s)[:2] for s in stations]
            along += (end - length + stations).tolist()
        self.points, self.along = np.array(points), np.array(along)

    def first_meeting(self, other: "_Way") -> float:
        """Return m along this way to the first point that is close to the other way."""
        apart = self.points[:, None] - other.points[None]
        near = ((apart * apart).sum(axis=2) < _NEAR * _NEAR).any(axis=1)
        return float(self.along[np.argmax(near)]) if near.any() else 0.0

    def common_lane(self, other: "_Way", release: float) -> tuple[float, float] | None:
        """Return m along both to where the last lane in common begins; None where they meet again behind."""
        shared = [place for place, lane in enumerate(other.lanes) if lane in self.place]
        if not shared or other.ends[shared[-1]] + _PARTING < release:
            return None
        first, own = shared[-1], self.place[other.lanes[shared[-1]]]
        while first > 0 and own > 0 and other.lanes[first - 1] == self.lanes[own - 1]:
            first, own = first - 1, own - 1
        return (
            float(self.ends[own - 1]) if own > 0 else 0.0,
            float(other.ends[first - 1]) if first > 0 else 0.0,
        )
