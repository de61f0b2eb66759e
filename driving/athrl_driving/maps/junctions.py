"""The junctions of a town: those of the file, joined where no vehicle could stand between them."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.opendrive.model import OpenDrive
from athrl_driving.maps.opendrive.strips import LanePiece
from athrl_driving.maps.stretches import Way

_KINDS = {1: "bend", 2: "passage", 3: "T-junction"}


@dataclass(frozen=True)
class Junction:
    """A junction's place name and kind.

    The kind is "roundabout" (one of its arms, or all of it), "ramp" (lanes merge or part at a small angle),
    or by the number of arms "passage", "T-junction" or "crossing".
    """

    name: str
    kind: str


def number_junctions(
    content: OpenDrive, ways: list[Way], ring: set[LanePiece], yields: NDArray[np.bool_]
) -> tuple[tuple[Junction, ...], NDArray[np.int64]]:
    """Return the junctions, and the number of each way's junction [M]."""
    parent: dict[str, str] = {}

    def root(name: str) -> str:
        parent.setdefault(name, name)
        while parent[name] != name:
            name = parent[name]
        return name

    # A way without a junction on it leads over a piece of road that is too short to stand on.
    names = [way.junctions or [f"road {way.pieces[0].strip.road.id}"] for way in ways]
    for own in names:
        for name in own[1:]:
            parent[root(name)] = root(own[0])
    numbers: dict[str, int] = {}
    junction_of = np.array([numbers.setdefault(root(own[0]), len(numbers)) for own in names], dtype=np.int64)
    junctions = []
    for name, number in numbers.items():
        own_ways = [way for way, place in zip(ways, junction_of, strict=True) if place == number]
        members = [member for member in parent if root(member) == name]
        titles = [content.junctions[item].name if item in content.junctions else item for item in members]
        junctions.append(Junction(" + ".join(titles), _kind(own_ways, ring, yields[junction_of == number])))
    return tuple(junctions), junction_of


def _kind(ways: list[Way], ring: set[LanePiece], yields: NDArray[np.bool_]) -> str:
    if any(piece in ring for way in ways for piece in (way.origin, *way.pieces, way.exit)):
        return "roundabout"
    if yields.any() and not any(abs(_change(way)) > 0.6 for way in ways):
        return "ramp"
    arms = Counter((way.origin.strip.road.id, way.origin.strip.forward) for way in ways)
    arms.update((way.exit.strip.road.id, not way.exit.strip.forward) for way in ways)
    return _KINDS.get(len(arms), "crossing")


def _change(way: Way) -> float:
    return sum(piece.curvature * piece.length for piece in way.pieces)
