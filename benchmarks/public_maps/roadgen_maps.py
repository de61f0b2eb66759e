"""Maps that roadgen writes: junctions, lights, motorways with interchanges."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path

import roadgen

Maker = Callable[[], roadgen.Map]

_STRAIGHT = [(-1000.0, 0.0, 0.0), (1000.0, 0.0, 0.0)]


def bend() -> roadgen.Map:
    """A road with a clothoid into and out of a bend, which rises."""
    alignment = roadgen.Alignment((0.0, 0.0, 0.0))
    alignment.line(100.0)
    alignment.spiral(40.0, 0.02)
    alignment.arc(50.0, 0.02, rise=2.0)
    alignment.spiral(40.0, 0.0)
    alignment.line(100.0)
    town = roadgen.Map()
    town.add_road(_lanes(1), alignment=alignment)
    return town


def crossroads_with_lights() -> roadgen.Map:
    """Four arms of two lanes a direction, a traffic light at each lane."""
    town = roadgen.Map()
    arms = _arms(town, 4, 2)
    _join(town, arms)
    for arm in arms:
        lanes = [lane for lane in arm.lanes() if lane.index >= 2]
        lights = [town.add_traffic_light(lane) for lane in lanes]
        town.add_traffic_light_rule(lights, lanes)
    return town


def junction_of_five() -> roadgen.Map:
    """Five arms of one lane a direction."""
    town = roadgen.Map()
    _join(town, _arms(town, 5, 1))
    return town


def grid() -> roadgen.Map:
    """Nine junctions in three rows, with roads out of the map on all sides."""
    town, size, gap = roadgen.Map(), 3, 14.0
    at: dict[tuple[int, int], list[tuple[roadgen.Road, str]]] = {}
    for row, column, down in itertools.product(range(-1, size), range(-1, size), (False, True)):
        begin, end = (row, column), (row + down, column + (not down))
        if (row if not down else column) < 0:
            continue
        (y0, x0), (y1, x1) = ((120.0 * place for place in node) for node in (begin, end))
        ahead = (gap * (x1 - x0) / 120.0, gap * (y1 - y0) / 120.0)
        road = town.add_road(
            _lanes(1), (x0 + ahead[0], y0 + ahead[1], 0.0), (x1 - ahead[0], y1 - ahead[1], 0.0)
        )
        at.setdefault(begin, []).append((road, "start"))
        at.setdefault(end, []).append((road, "end"))
    for node, arms in at.items():
        if len(arms) < 3:
            continue
        junction = town.add_junction(f"{node[0]}-{node[1]}")
        for (a, end_a), (b, end_b) in itertools.combinations(arms, 2):
            town.connect(a, b, junction=junction, ends=(end_a, end_b))
    return town


def motorway() -> roadgen.Map:
    """Two carriageways of two lanes with shoulders, through a bend of clothoids."""
    return _motorway([(-1000.0, 0.0, 0.0), (0.0, 0.0, 0.0), (900.0, 500.0, 0.0)])


def motorway_with_ramp() -> roadgen.Map:
    """The same, straight, and a ramp that leaves it from a lane of its own."""
    return _motorway(_STRAIGHT, lambda corridor: corridor.add_ramp("off", 800.0, (300.0, -120.0, 0.0)))


def motorway_with_diamond() -> roadgen.Map:
    """The same with an interchange: four ramps, and a road over it with two junctions."""
    across = [(0.0, -700.0, 0.0), (0.0, 700.0, 0.0)]
    return _motorway(
        _STRAIGHT, lambda corridor: corridor.add_interchange("diamond", 1000.0, across, _lanes(1))
    )


def left_hand_crossroads() -> roadgen.Map:
    """Four arms in a country that drives on the left."""
    town = roadgen.Map(handedness="lht")
    _join(town, _arms(town, 4, 1))
    return town


MAPS: tuple[Maker, ...] = (
    bend,
    crossroads_with_lights,
    junction_of_five,
    grid,
    motorway,
    motorway_with_ramp,
    motorway_with_diamond,
    left_hand_crossroads,
)


def write(make: Maker, path: Path) -> None:
    """Write a map to a file."""
    make().export_opendrive(str(path), trace=False)


def _lanes(each_way: int) -> list[roadgen.Lane]:
    return [
        roadgen.Lane(3.5, direction=direction)
        for direction in ("backward", "forward")
        for _ in range(each_way)
    ]


def _arms(town: roadgen.Map, count: int, lanes: int) -> list[roadgen.Road]:
    """Add roads that come in from all around and end 20 m before the centre."""
    arms = []
    for number in range(count):
        angle = number * 2.0 * math.pi / count
        x, y = math.cos(angle), math.sin(angle)
        arms.append(town.add_road(_lanes(lanes), (150.0 * x, 150.0 * y, 0.0), (20.0 * x, 20.0 * y, 0.0)))
    return arms


def _join(town: roadgen.Map, arms: list[roadgen.Road]) -> None:
    junction = town.add_junction("centre")
    for first, second in itertools.combinations(arms, 2):
        town.connect(first, second, junction=junction, ends=("end", "end"))


def _motorway(
    centre: list[tuple[float, float, float]], add: Callable[[roadgen.Corridor], None] | None = None
) -> roadgen.Map:
    town = roadgen.Map()
    corridor = town.add_corridor("A1", centre)
    if add is not None:
        add(corridor)
    town.add_plan(corridor.plan())
    return town
