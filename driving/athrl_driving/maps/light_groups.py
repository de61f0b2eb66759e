"""Which traffic lights change together: as controllers say, unless that would make crossing ways green."""

import math
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.disjoint_sets import DisjointSets
from athrl_driving.maps.lane_graph import TURN_STRAIGHT
from athrl_driving.maps.opendrive.model import OpenDrive, Signal
from athrl_driving.maps.priority import turn_of
from athrl_driving.maps.standing_segments import Movement

ONCOMING_WITHIN = math.radians(45.0)
"""Two approaches lie opposite each other if their directions differ by 180 degrees within this angle."""

Approach = tuple[str, bool]
"""The road that movements come from, and whether they drive along growing stations."""

_Name = tuple[int, str]
"""A junction's number, and what its lights are switched by."""


def group_lights(
    content: OpenDrive,
    movements: list[Movement],
    lights: list[Signal | None],
    junction: NDArray[np.int64],
    conflicts: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the group of lights of each movement [M], or -1; those of one group are green together.

    `lights` govern the movements, `junction` are the numbers of their junctions [M], `conflicts` the ordered
    pairs of conflicting movements [C, 2].
    """
    names = _names(content, movements, lights, junction)
    groups = np.full(len(movements), -1, dtype=np.int64)
    if not names:
        return groups
    part = _parts(content, movements, names, conflicts)
    numbers: dict[tuple[_Name, int], int] = {}
    for place, name in names.items():
        key = (name, part[name, approach_of(movements[place])])
        groups[place] = numbers.setdefault(key, len(numbers))
    return groups


def approach_of(movement: Movement) -> Approach:
    """Return the approach that a movement comes from."""
    carriageway = movement.origin.carriageway
    return carriageway.road.id, carriageway.forward


def crossing_pairs(movements: list[Movement], conflicts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the conflicting pairs [N, 2] that must not be green together, of `conflicts` [C, 2].

    Movements of one approach, and turns against oncoming traffic, may be: vehicles give way to each other.
    """
    numbers: dict[Approach, int] = {}
    approach = np.array([numbers.setdefault(approach_of(movement), len(numbers)) for movement in movements])
    straight = np.array([turn_of(movement) == TURN_STRAIGHT for movement in movements])
    heading = np.array([movement.origin.at(movement.origin.length)[2] for movement in movements])
    first, second = conflicts.T
    oncoming = np.cos(heading[first] - heading[second]) <= -math.cos(ONCOMING_WITHIN)
    cross = (approach[first] != approach[second]) & (~oncoming | (straight[first] & straight[second]))
    return conflicts[cross]


def _names(
    content: OpenDrive, movements: list[Movement], lights: list[Signal | None], junction: NDArray[np.int64]
) -> dict[int, _Name]:
    """Return what switches the light of each movement that has one.

    It is a controller; lights without one change with all others of their approach, and a light that several
    approaches refer to changes for all of them.
    """
    controllers = _controllers(content, {light.id for light in lights if light is not None})
    named_by = {junction.id: set(junction.controllers) for junction in content.junctions.values()}
    joined: DisjointSets[_Name] = DisjointSets()
    names: dict[int, _Name] = {}
    for place, (movement, light, number) in enumerate(zip(movements, lights, junction.tolist(), strict=True)):
        if light is None:
            continue
        if light.id in controllers:
            controller = _first_named(controllers[light.id], movement.junctions, named_by)
            names[place] = (number, f"controller {controller}")
        else:
            road, forward = approach_of(movement)
            names[place] = (number, f"lights of road {road} {'forth' if forward else 'back'}")
            joined.join(names[place], (number, f"signal {light.id}"))
    return {place: joined.root(name) for place, name in names.items()}


def _controllers(content: OpenDrive, lights: set[str]) -> dict[str, list[str]]:
    """Return the controllers of each light, in the order of the file."""
    result: dict[str, list[str]] = defaultdict(list)
    for name, signals in content.controllers.items():
        for signal in dict.fromkeys(signals):
            if signal in lights:
                result[signal].append(name)
    for signal, names in result.items():
        if len(names) > 1:
            kind = "a light of several controllers was given to the first that its junction names"
            content.findings.add(kind, f"signal {signal}", allowed=True)
    return result


def _first_named(controllers: list[str], junctions: list[str], named_by: dict[str, set[str]]) -> str:
    """Return the first of a light's controllers that one of the junctions names, else the first."""
    own = [named_by[junction] for junction in junctions if junction in named_by]
    named = (name for name in controllers if any(name in names for names in own))
    return next(named, controllers[0])


def _parts(
    content: OpenDrive, movements: list[Movement], names: dict[int, _Name], conflicts: NDArray[np.int64]
) -> dict[tuple[_Name, Approach], int]:
    """Return the part of its group that each approach belongs to; approaches that cross are apart."""
    crossing: dict[tuple[_Name, Approach], set[Approach]] = {}
    for place, name in names.items():
        crossing.setdefault((name, approach_of(movements[place])), set())
    for first, second in _within_groups(len(movements), names, crossing_pairs(movements, conflicts)):
        crossing[names[first], approach_of(movements[first])].add(approach_of(movements[second]))
    part: dict[tuple[_Name, Approach], int] = {}
    for (name, approach), others in crossing.items():
        taken = {part[name, other] for other in others if (name, other) in part}
        part[name, approach] = next(number for number in range(len(taken) + 1) if number not in taken)
    for _, switch in dict.fromkeys(name for (name, _), others in crossing.items() if others):
        kind = "lights that change together were separated, as their ways cross"
        content.findings.add(kind, switch, allowed=True)
    return part


def _within_groups(count: int, names: dict[int, _Name], pairs: NDArray[np.int64]) -> list[list[int]]:
    """Return the pairs of movements, of which there are `count`, that are switched together."""
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names.values()))}
    number_of = np.full(count, -1, dtype=np.int64)
    for place, name in names.items():
        number_of[place] = numbers[name]
    switched = number_of[pairs]
    together: list[list[int]] = pairs[(switched[:, 0] >= 0) & (switched[:, 0] == switched[:, 1])].tolist()
    return together
