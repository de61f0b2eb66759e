"""The traffic of E environments as a structure of arrays; what the kernels read and write.

Every array of `Background`, `RightOfWay`, `EgoOnLanes` and `Scratch` has a leading environment axis, which
the shapes below leave out: `environment_traffic` gives one environment's view, what kernels work on.
"""

from typing import NamedTuple

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from athrl_driving.compilation import inlined
from athrl_driving.maps import Town
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph, Movements

PATH_LENGTH = 20
"""Lanes that a vehicle plans ahead, its own first: more than the look-ahead reaches."""

EGO_FIELDS = 8
"""The ego is float64 [8]: x, y m, heading rad, speed m/s, length, width, elevation m, present (1 or 0)."""

NOBODY = -1


class Background(NamedTuple):
    """The background vehicles; a row is a vehicle."""

    x: Floats
    """[N] m, the centre."""
    y: Floats
    """[N] m."""
    heading: Floats
    """[N] rad."""
    elevation: Floats
    """[N] m."""
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
    offset: Floats
    """[N] m beside the lane's centre line, positive to the right; not 0 while it changes lanes."""
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


def new_traffic(
    town: Town,
    environments: int,
    count: int,
    length: float = float(IDMVehicle.LENGTH),
    width: float = float(IDMVehicle.WIDTH),
) -> Traffic:
    """Return arrays for `count` vehicles (m long and wide) in each environment, not placed yet.

    Raises `ValueError` for a negative count.
    """
    if count < 0:
        raise ValueError(f"vehicles_count is {count}, but it must be 0 or more")
    graph, movements = town.graph, town.movements
    return Traffic(
        graph=graph,
        movements=movements,
        pace=_pace(graph),
        background=_new_background((environments, count), length, width),
        right_of_way=_new_right_of_way(environments, count, len(graph.length), len(movements.length)),
        ego_on_lanes=_new_ego_on_lanes(environments, len(graph.length), len(movements.length)),
        scratch=_new_scratch(environments, count, len(graph.length)),
    )


def _pace(graph: LaneGraph) -> Floats:
    with np.errstate(divide="ignore"):
        curve_speed = np.sqrt(CURVE_ACCELERATION / np.abs(graph.curvature))
    return np.minimum(graph.speed_limit, curve_speed)


def _new_background(shape: tuple[int, int], length: float, width: float) -> Background:
    return Background(
        x=np.zeros(shape),
        y=np.zeros(shape),
        heading=np.zeros(shape),
        elevation=np.zeros(shape),
        speed=np.zeros(shape),
        length=np.full(shape, length),
        width=np.full(shape, width),
        lane=np.zeros(shape, np.int64),
        s=np.zeros(shape),
        offset=np.zeros(shape),
        acceleration=np.zeros(shape),
        desired_speed=np.zeros(shape),
        crashed=np.zeros(shape, np.bool_),
        path=np.zeros((*shape, PATH_LENGTH), np.int64),
        random_state=np.zeros(shape, np.uint64),
    )


def _new_right_of_way(environments: int, count: int, lanes: int, ways: int) -> RightOfWay:
    rows = (environments, count + 1)
    return RightOfWay(
        crossing=np.full(rows, NOBODY),
        granted=np.full(rows, NOBODY),
        granted_at=np.zeros(rows),
        ahead=np.full(rows, NOBODY),
        line_distance=np.full(rows, np.inf),
        waiting_since=np.full(rows, np.inf),
        holders=np.zeros((environments, ways), np.int64),
        rearmost=np.full((environments, ways), np.inf),
        inbound=np.zeros((environments, lanes), np.int64),
        claimed=np.zeros((environments, ways), np.bool_),
    )


def _new_ego_on_lanes(environments: int, lanes: int, ways: int) -> EgoOnLanes:
    return EgoOnLanes(
        rear=np.full((environments, lanes), np.inf),
        front=np.full((environments, lanes), -np.inf),
        speed=np.zeros((environments, lanes)),
        blocks=np.zeros((environments, ways), np.int64),
        lanes=np.zeros((environments, lanes), np.int64),
        movements=np.zeros((environments, ways), np.int64),
        counts=np.zeros((environments, 2), np.int64),
    )


def _new_scratch(environments: int, count: int, lanes: int) -> Scratch:
    rows = (environments, count + 1)
    return Scratch(
        first_on_lane=np.full((environments, lanes), NOBODY),
        next_on_lane=np.full((environments, count), NOBODY),
        gap=np.full(rows, np.inf),
        leader_speed=np.zeros(rows),
        held_up=np.zeros(rows, np.bool_),
        order=np.zeros(rows, np.int64),
        clock=np.zeros((environments, 1)),
    )


@inlined
def environment_traffic(traffic: Traffic, e: int) -> Traffic:
    """Return the view of environment `e`: the same memory without the environment axis."""
    background, right_of_way = traffic.background, traffic.right_of_way
    covered, scratch = traffic.ego_on_lanes, traffic.scratch
    return Traffic(
        traffic.graph,
        traffic.movements,
        traffic.pace,
        Background(
            background.x[e],
            background.y[e],
            background.heading[e],
            background.elevation[e],
            background.speed[e],
            background.length[e],
            background.width[e],
            background.lane[e],
            background.s[e],
            background.offset[e],
            background.acceleration[e],
            background.desired_speed[e],
            background.crashed[e],
            background.path[e],
            background.random_state[e],
        ),
        RightOfWay(
            right_of_way.crossing[e],
            right_of_way.granted[e],
            right_of_way.granted_at[e],
            right_of_way.ahead[e],
            right_of_way.line_distance[e],
            right_of_way.waiting_since[e],
            right_of_way.holders[e],
            right_of_way.rearmost[e],
            right_of_way.inbound[e],
            right_of_way.claimed[e],
        ),
        EgoOnLanes(
            covered.rear[e],
            covered.front[e],
            covered.speed[e],
            covered.blocks[e],
            covered.lanes[e],
            covered.movements[e],
            covered.counts[e],
        ),
        Scratch(
            scratch.first_on_lane[e],
            scratch.next_on_lane[e],
            scratch.gap[e],
            scratch.leader_speed[e],
            scratch.held_up[e],
            scratch.order[e],
            scratch.clock[e],
        ),
    )


def environment_views(traffic: Traffic, e: int) -> Traffic:
    """Return the same as `environment_traffic`, for Python."""
    return traffic._replace(
        background=Background(*(column[e] for column in traffic.background)),
        right_of_way=RightOfWay(*(column[e] for column in traffic.right_of_way)),
        ego_on_lanes=EgoOnLanes(*(column[e] for column in traffic.ego_on_lanes)),
        scratch=Scratch(*(column[e] for column in traffic.scratch)),
    )
