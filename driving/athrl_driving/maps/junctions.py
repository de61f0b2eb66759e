"""The junctions of a town: those of the file, joined where no vehicle could stand between them."""

from collections import Counter, defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.disjoint_sets import DisjointSets
from athrl_driving.maps.opendrive.carriageways import LaneSegment
from athrl_driving.maps.opendrive.model import OpenDrive
from athrl_driving.maps.priority import turned
from athrl_driving.maps.standing_segments import Movement

_RAMP_TURN = 0.6
"""Radians: where a movement turns by more, its junction is no ramp."""

_KINDS = {1: "bend", 2: "passage", 3: "T-junction"}


@dataclass(frozen=True)
class Junction:
    """A junction's place name and kind.

    The kind is "roundabout" (one of its arms, or all of it), "ramp" (lanes merge or diverge at a small
    angle), or by the number of arms "passage", "T-junction" or "crossing".
    """

    name: str
    kind: str


def number_junctions(
    content: OpenDrive, movements: list[Movement], ring: set[LaneSegment], yields: NDArray[np.bool_]
) -> tuple[tuple[Junction, ...], NDArray[np.int64]]:
    """Return the junctions, and the number of each movement's junction [M]."""
    joined: DisjointSets[str] = DisjointSets()
    # A movement without a junction on it leads over ordinary road that is too short to stand on.
    names = [
        movement.junctions or [f"road {movement.segments[0].carriageway.road.id}"] for movement in movements
    ]
    for first, *others in names:
        for name in others:
            joined.join(first, name)
    numbers: dict[str, int] = {}
    junction_of = np.array(
        [numbers.setdefault(joined.root(own[0]), len(numbers)) for own in names], dtype=np.int64
    )
    movements_of = defaultdict(list)
    for movement, number in zip(movements, junction_of.tolist(), strict=True):
        movements_of[number].append(movement)
    members_of = joined.sets()
    junctions = []
    for name, number in numbers.items():
        own_movements, members = movements_of[number], members_of[name]
        titles = [content.junctions[item].name if item in content.junctions else item for item in members]
        junctions.append(
            Junction(" + ".join(titles), _kind(own_movements, ring, yields[junction_of == number]))
        )
    return tuple(junctions), junction_of


def _kind(movements: list[Movement], ring: set[LaneSegment], yields: NDArray[np.bool_]) -> str:
    if any(
        segment in ring
        for movement in movements
        for segment in (movement.origin, *movement.segments, movement.exit)
    ):
        return "roundabout"
    if yields.any() and not any(abs(turned(movement)) > _RAMP_TURN for movement in movements):
        return "ramp"
    arms = Counter(
        (movement.origin.carriageway.road.id, movement.origin.carriageway.forward) for movement in movements
    )
    arms.update(
        (movement.exit.carriageway.road.id, not movement.exit.carriageway.forward) for movement in movements
    )
    return _KINDS.get(len(arms), "crossing")
