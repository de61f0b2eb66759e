"""Random towns: grids of streets, moved, thinned out and bent, for policies that should drive anywhere.

The width of lanes, speed limits, lights, avenues of two lanes a direction, roundabouts, and above all how
tight turns and bends are, differ from town to town and within a town: as they do in the maps of others, where
a policy that was trained in the project's own towns alone leaves its lane.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Sequence
from random import Random

from athrl_driving.maps.making.description import Bend, Node, Road, Roundabout, Town
from athrl_driving.maps.making.laying import lay_town
from athrl_driving.maps.making.plan import TownPlan
from athrl_driving.maps.making.streets import Place, Point, Street, grid, joined, streets_at, thinned_out

VERSION = 1
"""To be raised by every change after which a seed gives another town."""

ATTEMPTS = 200
"""Drafts of a town. Many cannot be laid, for instance as two roads at a node are too near to each other."""

_LEAST_LANES = 3500.0
"""Metres of lanes outside of junctions, for a hundred vehicles."""
_LEAST_ROAD = 12.0
"""Metres between two junctions, so that vehicles have room to wait there."""

_BLOCK = (70.0, 150.0)
"""Metres between two columns or rows of streets."""
_MOVED = 14.0
"""Metres by which nodes are moved out of the grid, at most."""
_LANE_WIDTH = (3.2, 4.0)
_TIGHTEST_TURN = (2.5, 6.0)
"""Metres: between these lies the smallest radius of a town's right turns. A car swings wide to drive them."""
_WIDEST_TURN = (8.0, 14.0)
_BEND = (7.0, 80.0)
"""Metres: radius of bends, in the middle of the road."""
_LEAST_BEND = 5.5
_AVENUE_WIDER = 4.0
"""Metres by which the least bend of an avenue is wider: its inner lane lies by so much farther inside."""
_SWERVE = (2.0, 16.0)
"""Metres by which a street that swerves leaves the straight line."""
_STRAIGHT_NEAR_NODE = 20.0
_ROUNDABOUT = (24.0, 32.0)
_STREET_MPH, _AVENUE_MPH = (20, 25, 30, 35, 40), (35, 40, 45, 50)


def lay_random_town(seed: int) -> TownPlan:
    """Return the plan of the town named `random-SEED`: the same on every machine, but for rounding.

    Raises `ValueError` where no draft can be laid, which has not been seen in 3,000 seeds.
    """
    for attempt in range(ATTEMPTS):
        try:
            plan = lay_town(_draft(f"random-{seed}", Random(f"{seed}/{attempt}")))
        except ValueError:
            continue
        if _is_roomy(plan):
            return plan
    raise ValueError(f"random-{seed}: none of {ATTEMPTS} drafts can be laid")


def checksum(seed: int) -> str:
    """Return the SHA-256, hexadecimal, of what the town of a seed depends on.

    It is not that of the town's text, in which the last digits may depend on the processor.
    """
    return hashlib.sha256(f"random town {seed}, version {VERSION}".encode()).hexdigest()


def _is_roomy(plan: TownPlan) -> bool:
    """Whether there is room for traffic, and room to wait between junctions."""
    roads = [road for road in plan.roads if road.junction < 0]
    lanes = {road.number: sum(lane.kind == "driving" for lane in road.sections[0].lanes) for road in roads}
    return (
        min(road.length for road in roads) >= _LEAST_ROAD
        and sum(road.length * lanes[road.number] for road in roads) >= _LEAST_LANES
    )


def _draft(name: str, random: Random) -> Town:
    """Describe a town. Raises `ValueError` where the draft is of no use."""
    columns, rows = random.choice((3, 4, 4, 5)), random.choice((3, 4, 4, 5))
    position = _positions(columns, rows, random)
    avenue_column = random.choice((None, random.randrange(1, columns - 1)))
    avenue_row = random.choice((None, random.randrange(1, rows - 1)))
    streets = grid(columns, rows, avenue_column, avenue_row)
    streets = joined(thinned_out(streets, random.uniform(0.0, 0.4), random), position)
    turns = random.uniform(*_TIGHTEST_TURN), random.uniform(*_WIDEST_TURN)
    swerving = {False: 0.4, True: random.choice((0.0, 0.4))}  # straight avenues have room for a roundabout
    return Town(
        name,
        nodes=tuple(
            _node(place, position[place], meeting, turns, random)
            for place in position
            if (meeting := streets_at(place, streets))
        ),
        roads=tuple(
            _road(street, [position[end] for end in street.ends], swerving[street.avenue], random)
            for street in streets
        ),
        lane_width=round(random.uniform(*_LANE_WIDTH), 2),
    )


def _positions(columns: int, rows: int, random: Random) -> dict[Place, Point]:
    """Return where the nodes lie: each is moved a little out of the grid."""
    x = list(itertools.accumulate(random.uniform(*_BLOCK) for _ in range(columns)))
    y = list(itertools.accumulate(random.uniform(*_BLOCK) for _ in range(rows)))
    moved = random.uniform(0.0, _MOVED)

    def near(metres: float) -> float:
        return round(metres + random.uniform(-moved, moved), 1)

    return {
        (column, row): (near(x[column]), near(y[row])) for column in range(columns) for row in range(rows)
    }


def _node(
    place: Place, at: Point, meeting: Sequence[Street], turns: tuple[float, float], random: Random
) -> Node | Roundabout:
    crossing = len(meeting) == 4
    if crossing and all(street.avenue for street in meeting) and random.random() < 0.6:
        return Roundabout(_name(place), *at, round(random.uniform(*_ROUNDABOUT), 1))
    signals = crossing and random.random() < 0.3
    return Node(_name(place), *at, signals, round(_log_uniform(*turns, random), 1))


def _road(street: Street, ends: Sequence[Point], swerving: float, random: Random) -> Road:
    """Describe a street between the points of its ends; a share of `swerving` of straight ones swerve."""
    if street.ends[0] == street.ends[1]:
        raise ValueError(f"the street at {street.ends[0]} leads back to where it begins")
    (start, end), corners = ends, street.corners
    if not corners and random.random() < swerving:
        corners = _swerve(start, end, random)
    return Road(
        _name(street.ends[0]),
        _name(street.ends[1]),
        bends=_bends([start, *corners, end], _AVENUE_WIDER if street.avenue else 0.0, random),
        lanes=(2, 2) if street.avenue else (1, 1),
        mph=random.choice(_AVENUE_MPH if street.avenue else _STREET_MPH),
        major=street.avenue,
    )


def _swerve(start: Point, end: Point, random: Random) -> tuple[Point, Point]:
    """Return two corners between two points, each to one side of the straight line."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)

    def corner(share: float) -> Point:
        aside = random.choice((-1.0, 1.0)) * random.uniform(*_SWERVE) / length
        return round(start[0] + share * dx - aside * dy, 1), round(start[1] + share * dy + aside * dx, 1)

    return corner(random.uniform(0.35, 0.45)), corner(random.uniform(0.55, 0.65))


def _bends(points: Sequence[Point], wider: float, random: Random) -> tuple[Bend, ...]:
    """Return the corners between the first point and the last, as round as there is room for at most.

    The least radius is by `wider` metres wider than a street's. Raises `ValueError` where it has no room.
    """
    lengths = [math.dist(*pair) for pair in itertools.pairwise(points)]
    lengths[0] -= _STRAIGHT_NEAR_NODE
    lengths[-1] -= _STRAIGHT_NEAR_NODE
    bends = []
    for index, corner in enumerate(points[1:-1]):
        turn = abs(_turn(*points[index : index + 3]))
        room = 0.45 * min(lengths[index : index + 2])
        widest = room / max(math.tan(turn / 2.0), 1e-3)
        radius = min(_log_uniform(_BEND[0] + wider, _BEND[1], random), widest)
        if radius < _LEAST_BEND + wider:
            raise ValueError(f"there is no room for a bend at {corner}")
        bends.append(Bend(*corner, round(radius, 1)))
    return tuple(bends)


def _turn(before: Point, corner: Point, after: Point) -> float:
    """Return the change of direction at a corner, rad."""
    first = math.atan2(corner[1] - before[1], corner[0] - before[0])
    second = math.atan2(after[1] - corner[1], after[0] - corner[0])
    return math.remainder(second - first, math.tau)


def _name(place: Place) -> str:
    """Return the name of a place, such as b3."""
    return f"{'abcdefgh'[place[0]]}{place[1] + 1}"


def _log_uniform(low: float, high: float, random: Random) -> float:
    return math.exp(random.uniform(math.log(low), math.log(high)))
