"""Random road networks, made by scenariogeneration: loops, open roads, crossings, ramps.

Each function takes a generator, of which alone its result depends, and returns a valid network.
"""

from __future__ import annotations

import math
from itertools import count, pairwise
from random import Random
from typing import Any

from scenariogeneration import xodr

Network = Any
"""A `scenariogeneration.xodr.OpenDrive` (the package has no types)."""

_LANE_WIDTHS = (2.5, 3.0, 3.5, 4.0)
_END, _START = xodr.ContactPoint.end, xodr.ContactPoint.start


def loop(chance: Random) -> Network:
    """Return a closed road with as many corners and parts as it happens."""
    corners = chance.randint(2, 6)
    sides = [chance.uniform(5.0, 150.0) for _ in range(corners // 2)] * 2
    if corners % 2:
        sides = [sides[0]] * corners
    radius, easing = chance.uniform(8.0, 60.0), chance.choice([0.0, 0.0, chance.uniform(0.05, 0.4)])
    geometries = []
    for side in sides:
        geometries += [xodr.Line(side), *_corner(1.0 / radius, 2.0 * math.pi / len(sides), easing)]
    roads = _roads(chance, geometries)
    for one, other in zip(roads, [*roads[1:], roads[0]], strict=True):
        one.add_successor(xodr.ElementType.road, other.id, _START)
        other.add_predecessor(xodr.ElementType.road, one.id, _END)
    return _network(roads)


def open_road(chance: Random) -> Network:
    """Return a road with two ends and any curves, in several parts, whose number of lanes may change."""
    geometries = [_piece(chance) for _ in range(chance.randint(1, 8))]
    roads = _roads(chance, geometries, changes=True)
    for one, other in pairwise(roads):
        one.add_successor(xodr.ElementType.road, other.id, _START)
        other.add_predecessor(xodr.ElementType.road, one.id, _END)
    return _network(roads)


def crossing(chance: Random) -> Network:
    """Return a junction of three to five roads, some of which lead back to it and the others nowhere."""
    arms, width = chance.randint(3, 5), chance.choice(_LANE_WIDTHS)
    ties = chance.randint(0, arms // 2)
    right = chance.randint(1, 2)
    left = right if ties else chance.randint(0, 2)
    creator = xodr.CommonJunctionCreator(100, "crossing", startnum=1000)
    roads = []
    for number in range(arms):
        pieces = [xodr.Line(chance.uniform(10.0, 120.0))]
        pieces += [_piece(chance)] if chance.random() < 0.5 else []
        road = xodr.create_road(pieces, number, left, right, lane_width=width)
        angle = 2.0 * math.pi * (number + chance.uniform(-0.15, 0.15)) / arms
        creator.add_incoming_road_circular_geometry(road, chance.uniform(14.0, 30.0), angle, "predecessor")
        roads.append(road)
    for one in range(arms):
        for other in range(one):
            # Neighbours always, so that the network is one.
            if one - other == 1 or ties or chance.random() < 0.9:
                creator.add_connection(one, other)
    ends = chance.sample(roads, 2 * ties)
    pairs = zip(ends[::2], ends[1::2], strict=True)
    tied = [_tie(*pair, arms + number, right, width) for number, pair in enumerate(pairs)]
    return _network([*roads, *tied], [creator])


def ramp(chance: Random) -> Network:
    """Return a road that divides, or two that merge, in a direct junction."""
    lanes, width = chance.randint(1, 3), chance.choice(_LANE_WIDTHS)
    main = xodr.create_road(xodr.Line(chance.uniform(30.0, 200.0)), 0, 0, lanes + 1, lane_width=width)
    ahead = xodr.create_road(xodr.Line(chance.uniform(30.0, 200.0)), 1, 0, lanes, lane_width=width)
    curve = xodr.Arc(-chance.uniform(0.002, 0.02), length=chance.uniform(30.0, 120.0))
    off = xodr.create_road(curve, 2, 0, 1, lane_width=width)
    merges = chance.random() < 0.5
    ends = ("predecessor", "successor") if merges else ("successor", "predecessor")
    junction = xodr.DirectJunctionCreator(100, "ramp")
    for road in (main, ahead, off):
        link = ends[0] if road is main else ends[1]
        getattr(road, f"add_{link}")(xodr.ElementType.junction, 100)
    own = [-1 - lane for lane in range(lanes)]
    junction.add_connection(main, ahead, own, own)
    junction.add_connection(main, off, -lanes - 1, -1)
    return _network([main, ahead, off], [junction])


def unconnected(chance: Random) -> Network:
    """Return roads that lie across each other in any way, without a junction."""
    roads = []
    for number in range(chance.randint(2, 5)):
        pieces = [_piece(chance) for _ in range(chance.randint(1, 3))]
        left, right = chance.choice([(0, 1), (1, 1), (2, 2), (1, 2)])
        road = xodr.create_road(pieces, number, left, right, lane_width=chance.choice(_LANE_WIDTHS))
        start = chance.uniform(-60.0, 60.0), chance.uniform(-60.0, 60.0)
        road.planview.set_start_point(*start, chance.uniform(-math.pi, math.pi))
        roads.append(road)
    return _network(roads)


NETWORKS = (loop, loop, open_road, crossing, crossing, ramp, unconnected)
"""The kinds; one that is more important comes twice."""


def _corner(curvature: float, angle: float, easing: float) -> list[Any]:
    """Return a curve by `angle` (rad); a share `easing` of it, at each end, is a spiral."""
    if not easing:
        return [xodr.Arc(curvature, angle=angle)]
    return [
        xodr.Spiral(1e-9, curvature, angle=easing * angle),
        xodr.Arc(curvature, angle=(1.0 - 2.0 * easing) * angle),
        xodr.Spiral(curvature, 1e-9, angle=easing * angle),
    ]


def _piece(chance: Random) -> Any:
    """Return a line, an arc, a spiral, or a curve of third degree."""
    length, bend = math.exp(chance.uniform(0.0, 5.0)), chance.uniform(-0.04, 0.04)
    match chance.randrange(4):
        case 0:
            return xodr.Line(length)
        case 1:
            return xodr.Arc(bend or 0.01, length=length)
        case 2:
            return xodr.Spiral(1e-9, bend or 0.01, length=length)
        case _:
            sideways = 0.5 * bend * length**2
            return xodr.ParamPoly3(
                0, length, 0, 0, 0, 0, sideways, -0.3 * sideways, prange="normalized", length=length
            )


def _roads(chance: Random, geometries: list[Any], changes: bool = False) -> list[Any]:
    """Return roads of one or more geometries each; with `changes` some gain or lose lanes."""
    left, right = chance.choice([(0, 1), (0, 2), (1, 1), (1, 2), (2, 2), (3, 0), (0, 4)])
    width, numbers, roads = chance.choice(_LANE_WIDTHS), count(), []
    while geometries:
        size = chance.randint(1, len(geometries))
        own, geometries = geometries[:size], geometries[size:]
        long = sum(each.length for each in own)
        lanes: Any = right
        if changes and right and long > 40.0 and chance.random() < 0.4:
            after = max(1, right + chance.choice([-1, 1]))
            if after != right:
                outer = -max(after, right)
                lanes = [xodr.LaneDef(0.2 * long, 0.7 * long, right, after, outer)]
                right = after
        roads.append(xodr.create_road(own, next(numbers), left, lanes, lane_width=width))
    return roads


def _tie(one: Any, other: Any, number: int, lanes: int, width: float) -> Any:
    """Return a road from the open end of one road to that of another."""
    tie = xodr.create_road(xodr.AdjustablePlanview(), number, lanes, lanes, lane_width=width)
    tie.add_predecessor(xodr.ElementType.road, one.id, _END)
    tie.add_successor(xodr.ElementType.road, other.id, _END)
    one.add_successor(xodr.ElementType.road, number, _START)
    other.add_successor(xodr.ElementType.road, number, _END)
    return tie


def _network(roads: list[Any], junctions: list[Any] | None = None) -> Network:
    network = xodr.OpenDrive("generated")
    for road in roads:
        network.add_road(road)
    for junction in junctions or []:
        network.add_junction_creator(junction)
    network.adjust_roads_and_lanes()
    return network
