"""The traffic as a structure of arrays, N background vehicles; what the kernels read and write."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph, Movements

PATH_LENGTH = 20
"""Lanes that a vehicle plans ahead, its own first: more than the look-ahead reaches."""

NOBODY = -1


class Background(NamedTuple):
    """The background vehicles; a row is a vehicle."""

    x: Floats
    """[N] m, the centre."""
    y: Floats
    """[N] m."""
    heading: Floats
    """[N] rad."""
    speed: Floats
    """[N] m/s."""
    length: Floats
    """[N] m."""
    width: Floats
    """[N] m."""
    lane: Integers
    """[N] row of the lane graph."""
    s: Floats
    """[N] m along the lane."""
    acceleration: Floats
    """[N] m/s2, of the last tick."""
    desired_speed: Floats
    """[N] m/s on a free road."""
    crashed: NDArray[np.bool_]
    """[N] hit by the ego."""
    path: Integers
    """[N, PATH_LENGTH] the lanes ahead, the present one first."""
    random_state: NDArray[np.uint64]
    """[N] each vehicle's own random numbers, so that its turns do not depend on the order of the others."""


class RightOfWay(NamedTuple):
    """Who may cross which junction. Rows 0..N-1 are the background vehicles, row N is the ego."""

    crossing: Integers
    """[N+1] the movement that the vehicle is on, until its rear has left it; -1 none."""
    granted: Integers
    """[N+1] the movement ahead that it holds; -1 none."""
    granted_at: Floats
    """[N+1] s."""
    ahead: Integers
    """[N+1] the next movement on its path; -1 where none is near."""
    line_distance: Floats
    """[N+1] m from its front to the stop line of `ahead`; infinite where none is near."""
    waiting_since: Floats
    """[N+1] s since when it asks for `ahead`; infinite while it does not ask."""
    holders: Integers
    """[M] vehicles that hold or cross a movement."""
    rearmost: Floats
    """[M] m along the movement to the rear of its last vehicle; minus infinity before that enters."""
    inbound: Integers
    """[L] vehicles that hold a movement to this lane and have not arrived on it."""
    claimed: NDArray[np.bool_]
    """[M] somebody who waits longer than the present one wants this movement."""


class EgoOnLanes(NamedTuple):
    """The ego as an obstacle: what its body covers of every lane."""

    rear: Floats
    """[L] m along the lane to the nearest point of the body on the lane; infinite where there is none."""
    front: Floats
    """[L] m to the farthest point."""
    speed: Floats
    """[L] m/s along the lane."""
    blocks: Integers
    """[M] 0 not on the movement, 1 it covers a part of it, 2 it drives along it."""
    lanes: Integers
    """[L] the covered lanes."""
    movements: Integers
    """[M] the covered movements."""
    counts: Integers
    """[2] of covered lanes and movements."""


class Scratch(NamedTuple):
    """Room for what is computed anew in every tick."""

    first_on_lane: Integers
    """[L] a vehicle on the lane, or -1."""
    next_on_lane: Integers
    """[N] another vehicle on the same lane, or -1."""
    gap: Floats
    """[N+1] m from bumper to bumper to the leader; infinite without one."""
    leader_speed: Floats
    """[N+1] m/s along the path."""
    held_up: NDArray[np.bool_]
    """[N+1] the leader is before the stop line and holds no right to cross."""
    order: Integers
    """[N+1] the vehicles that ask for a movement, who is served first in front."""
    clock: Floats
    """[1] s since the episode's start."""


class Traffic(NamedTuple):
    """Everything that a tick needs."""

    graph: LaneGraph
    movements: Movements
    pace: Floats
    """[L] m/s: the speed limit, or what the curve allows."""
    background: Background
    right_of_way: RightOfWay
    ego_on_lanes: EgoOnLanes
    scratch: Scratch


CURVE_ACCELERATION = 2.2
"""m/s2 sideways that background vehicles accept in a curve."""


def new_traffic(graph: LaneGraph, movements: Movements, count: int, length: float, width: float) -> Traffic:
    """Return arrays for `count` vehicles (m long and wide) that are not placed yet."""
    lanes, ways = len(graph.length), len(movements.length)
    with np.errstate(divide="ignore"):
        curve_speed = np.sqrt(CURVE_ACCELERATION / np.abs(graph.curvature))
    background = Background(
        x=np.zeros(count),
        y=np.zeros(count),
        heading=np.zeros(count),
        speed=np.zeros(count),
        length=np.full(count, length),
        width=np.full(count, width),
        lane=np.zeros(count, np.int64),
        s=np.zeros(count),
        acceleration=np.zeros(count),
        desired_speed=np.zeros(count),
        crashed=np.zeros(count, np.bool_),
        path=np.zeros((count, PATH_LENGTH), np.int64),
        random_state=np.zeros(count, np.uint64),
    )
    right_of_way = RightOfWay(
        crossing=np.full(count + 1, NOBODY),
        granted=np.full(count + 1, NOBODY),
        granted_at=np.zeros(count + 1),
        ahead=np.full(count + 1, NOBODY),
        line_distance=np.full(count + 1, np.inf),
        waiting_since=np.full(count + 1, np.inf),
        holders=np.zeros(ways, np.int64),
        rearmost=np.full(ways, np.inf),
        inbound=np.zeros(lanes, np.int64),
        claimed=np.zeros(ways, np.bool_),
    )
    ego_on_lanes = EgoOnLanes(
        rear=np.full(lanes, np.inf),
        front=np.full(lanes, -np.inf),
        speed=np.zeros(lanes),
        blocks=np.zeros(ways, np.int64),
        lanes=np.zeros(lanes, np.int64),
        movements=np.zeros(ways, np.int64),
        counts=np.zeros(2, np.int64),
    )
    scratch = Scratch(
        first_on_lane=np.full(lanes, NOBODY),
        next_on_lane=np.full(count, NOBODY),
        gap=np.full(count + 1, np.inf),
        leader_speed=np.zeros(count + 1),
        held_up=np.zeros(count + 1, np.bool_),
        order=np.zeros(count + 1, np.int64),
        clock=np.zeros(1),
    )
    pace = np.minimum(graph.speed_limit, curve_speed)
    return Traffic(graph, movements, pace, background, right_of_way, ego_on_lanes, scratch)
