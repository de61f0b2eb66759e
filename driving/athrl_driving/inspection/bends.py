"""How tight a map's bends are, and how tight the ego can turn."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from athrl_spaces import Limits

from athrl_driving.control import MAXIMUM_STEERING, WHEEL_ANGLE_PER_STEERING
from athrl_driving.control.waypoint import PROPORTIONAL
from athrl_driving.episode.ego import EGO_WHEELBASE
from athrl_driving.episode.starts import in_driving_order
from athrl_driving.maps import Town
from athrl_driving.maps.road_names import told_names

_LEAST_TURN = math.radians(10.0)
"""A piece of lane that turns by less is no bend: it may be a joint that was smoothed."""


@dataclass(frozen=True)
class Bend:
    """A bend of a lane."""

    radius: float
    """m, of the lane's centre line."""
    road: str
    """Its name, followed by its id where other roads have that name too."""
    lane: int
    metres: float
    """Where it begins: m along the road's lane, in the direction of driving."""


@dataclass(frozen=True)
class Bends:
    """The tightest bend of a map, against what the ego can steer."""

    ego_radius: float
    """m, of the tightest circle on which the ego can drive."""
    tightest: Bend | None
    """None on a map without bends."""
    too_tight: int
    """Lanes of roads with a bend that is tighter than the ego can drive."""


def ego_radius(limits: Limits | None = None) -> float:
    """Return the radius (m) of the tightest circle that the ego's centre can follow.

    The steering loop's command is its gain times the waypoint's angle, at most full lock. The front wheels
    turn by that, and the bicycle model moves the ego.
    """
    angle = (limits or Limits()).waypoint_half_angle
    wheel_angle = min(PROPORTIONAL * angle, MAXIMUM_STEERING) * WHEEL_ANGLE_PER_STEERING
    slip = math.atan(0.5 * math.tan(wheel_angle))
    return 0.5 * EGO_WHEELBASE / math.sin(slip)


def bends_of(town: Town) -> Bends:
    """Return the tightest bend that vehicles drive, and how many lanes are too tight for the ego."""
    graph, able = town.graph, ego_radius()
    curvature = np.abs(graph.curvature) * (np.abs(graph.curvature) * graph.length >= _LEAST_TURN)
    too_tight = np.flatnonzero(curvature * able > 1.0).tolist()
    return Bends(
        ego_radius=able,
        tightest=_bend(town, int(curvature.argmax())) if curvature.any() else None,
        too_tight=len({(town.road_id[lane], int(town.lane_id[lane])) for lane in too_tight}),
    )


def _bend(town: Town, lane: int) -> Bend:
    told = told_names(zip(town.road_id, town.road_name, strict=True))
    return Bend(
        radius=1.0 / abs(float(town.graph.curvature[lane])),
        road=told[town.road_id[lane]],
        lane=int(town.lane_id[lane]),
        metres=_metres_before(town, lane),
    )


def _metres_before(town: Town, lane: int) -> float:
    """Return the length of the road's lane before one of its pieces, m."""
    graph = town.graph
    road, lane_id = np.array(town.road_id) == town.road_id[lane], town.lane_id == town.lane_id[lane]
    # A lane through a junction is in the graph once for each movement.
    pieces = np.flatnonzero(road & lane_id & (graph.movement == graph.movement[lane]))
    before = itertools.takewhile(lambda piece: piece != lane, in_driving_order(town, pieces))
    return float(graph.length[list(before)].sum())
