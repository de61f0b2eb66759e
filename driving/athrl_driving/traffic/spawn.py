"""Where the background vehicles of a new episode start, and how fast."""

import math

import numpy as np
from numpy.typing import NDArray

from athrl_driving.compilation import compiled
from athrl_driving.maps.geometry import lane_pose
from athrl_driving.maps.lane_graph import Floats, LaneGraph
from athrl_driving.traffic.paths import plan_from
from athrl_driving.traffic.right_of_way import LINE_BRAKING
from athrl_driving.traffic.state import NOBODY, Background, Traffic, environment_views
from athrl_driving.traffic.tick import LINE_MARGIN, tick

SPACING = 12.0
"""Metres between the centres of two places on a lane where a vehicle may start."""

_JITTER = 1.0
_SHORTEST_LANE = 25.0
_REACTION_ROOM = 1.0


def starting_places(graph: LaneGraph) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return lanes and m along them where vehicles may start: on streets, out of junctions and rings."""
    lanes: list[int] = []
    along: list[float] = []
    for lane in np.flatnonzero((graph.junction < 0) & (graph.length >= _SHORTEST_LANE)):
        count = int(graph.length[lane] // SPACING)
        lanes += [int(lane)] * count
        along += [(place + 0.5) * SPACING for place in range(count)]
    return np.array(lanes, dtype=np.int64), np.array(along)


def place_vehicles(
    traffic: Traffic,
    e: int,
    np_random: np.random.Generator,
    keep_clear_of: tuple[float, float] | None,
    clearance: float,
    ego: Floats,
) -> None:
    """Place every vehicle of environment `e` anew, none within `clearance` metres of `keep_clear_of`.

    They start with speeds at which they can stop behind each other, behind the ego (float64 [8]) and at their
    stop lines. Raises `ValueError` where the town has no room.
    """
    view = environment_views(traffic, e)
    background, right_of_way = view.background, view.right_of_way
    count = len(background.lane)
    lanes, along = starting_places(traffic.graph)
    order = np_random.permutation(len(lanes))
    lanes, along = lanes[order], along[order] + np_random.uniform(-_JITTER, _JITTER, len(lanes))
    desired_speeds = np_random.uniform(7.0, 9.0, count)
    haste = np_random.uniform(0.5, 1.0, count)
    background.random_state[:] = np_random.integers(0, 2**63, count, dtype=np.uint64)
    x, y = keep_clear_of if keep_clear_of is not None else (math.inf, math.inf)
    _forget(view)
    placed = _place(traffic.graph, background, lanes, along, x, y, clearance)
    if placed < count:
        raise ValueError(f"vehicles_count is {count}, but the town has room for {placed} at most")
    background.desired_speed[:] = desired_speeds
    # A speed with which everybody can still stop behind its leader and before its line.
    background.speed[:] = 0.0
    tick(traffic, e, ego, np.empty(0, dtype=np.int64), 0.0)
    line = right_of_way.line_distance[:count] - LINE_MARGIN
    room = np.minimum(view.scratch.gap[:count] - 2.0, line)
    safe = np.sqrt(2.0 * LINE_BRAKING * np.clip(room - _REACTION_ROOM, 0.0, None))
    speeds = haste * np.minimum(desired_speeds, traffic.pace[background.lane])
    background.speed[:] = np.minimum(speeds, safe)


def _forget(view: Traffic) -> None:
    """Clear what an episode before has left."""
    right_of_way, background = view.right_of_way, view.background
    for held in (right_of_way.crossing, right_of_way.granted, right_of_way.ahead):
        held[:] = NOBODY
    right_of_way.waiting_since[:] = np.inf
    right_of_way.granted_at[:] = 0.0
    view.scratch.clock[:] = 0.0
    for column in (background.offset, background.acceleration, background.crashed, background.elevation):
        column[:] = 0


@compiled
def _place(
    graph: LaneGraph,
    background: Background,
    lanes: NDArray[np.int64],
    along: Floats,
    x: float,
    y: float,
    clearance: float,
) -> int:
    """Put the vehicles on the first places that are clear and return how many found one."""
    placed = 0
    for index in range(lanes.shape[0]):
        if placed == background.lane.shape[0]:
            break
        place_x, place_y, heading = lane_pose(graph, lanes[index], along[index])
        if math.hypot(place_x - x, place_y - y) <= clearance:
            continue
        background.lane[placed], background.s[placed] = lanes[index], along[index]
        background.x[placed], background.y[placed], background.heading[placed] = place_x, place_y, heading
        background.path[placed, 0] = lanes[index]
        plan_from(graph, background, placed, 1)
        placed += 1
    return placed
