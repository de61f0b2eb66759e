"""One tick of the traffic: everybody looks, the junctions are served, everybody accelerates, everybody moves.

Background vehicles drive on rails: they keep to the centre line of the lanes of their path and change their
speed only. They do not change lanes beside each other; where a street has two lanes, the turn before it
decides which one they take. All decisions see the state before the tick.
"""

import math

from numba import njit

from athrl_driving.maps.geometry import lane_pose
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.traffic.ego import cover_lanes, forget_ego, locate_on_path
from athrl_driving.traffic.following import (
    LARGEST_ACCELERATION,
    REFERENCE_LENGTH,
    approach_speed,
    idm_acceleration,
)
from athrl_driving.traffic.leaders import LOOK_AHEAD, look_ahead, sort_by_lane
from athrl_driving.traffic.paths import drop_first
from athrl_driving.traffic.right_of_way import LINE_BRAKING, ask, count_holders, serve
from athrl_driving.traffic.state import NOBODY, PATH_LENGTH, Traffic

LINE_MARGIN = 0.5
"""Metres between a waiting vehicle's front and the stop line."""

_LEAST_GAP = 1.0


@njit(cache=True, nogil=True)
def look(traffic: Traffic, ego: Floats, ego_path: Integers) -> None:
    """Find everybody's leader and junction. `ego`: x, y, heading, speed, length, width; empty without one."""
    background = traffic.background
    vehicles = background.lane.shape[0]
    sort_by_lane(traffic)
    if ego.shape[0] > 0:
        cover_lanes(traffic, ego)
    else:
        forget_ego(traffic)
    for row in range(vehicles):
        look_ahead(traffic, row, background.path[row], 0, background.s[row], background.length[row], True)
    traffic.right_of_way.ahead[vehicles] = NOBODY
    traffic.right_of_way.line_distance[vehicles] = math.inf
    traffic.scratch.gap[vehicles] = math.inf
    traffic.scratch.held_up[vehicles] = False
    if ego.shape[0] > 0:
        _look_for_ego(traffic, ego, ego_path)


@njit(cache=True, nogil=True)
def _look_for_ego(traffic: Traffic, ego: Floats, ego_path: Integers) -> None:
    """Find the ego's leader and next junction, and note the movement that it is on."""
    graph, right_of_way = traffic.graph, traffic.right_of_way
    row = traffic.background.lane.shape[0]
    place, s = locate_on_path(traffic, ego, ego_path)
    if place < 0:
        right_of_way.crossing[row] = NOBODY
        return
    movement = graph.movement[ego_path[place]]
    if movement >= 0:
        right_of_way.crossing[row] = movement
        if right_of_way.granted[row] == movement:
            right_of_way.granted[row] = NOBODY
    elif s > 0.5 * ego[4]:
        right_of_way.crossing[row] = NOBODY
    look_ahead(traffic, row, ego_path, place, s, ego[4], False)


@njit(cache=True, nogil=True)
def advance(traffic: Traffic, ego: Floats, ego_path: Integers, dt: float) -> None:
    """Move the background vehicles on by `dt` seconds."""
    background = traffic.background
    vehicles = background.lane.shape[0]
    look(traffic, ego, ego_path)
    for row in range(vehicles):
        ask(traffic, row, background.speed[row])
    ask(traffic, vehicles, ego[3] if ego.shape[0] > 0 else 0.0)
    count_holders(traffic)
    serve(traffic)
    for row in range(vehicles):
        background.acceleration[row] = _acceleration(traffic, row, dt)
    for row in range(vehicles):
        _move(traffic, row, dt)
    traffic.scratch.clock[0] += dt


@njit(cache=True, nogil=True)
def _acceleration(traffic: Traffic, row: int, dt: float) -> float:
    """Return the car-following acceleration (m/s2), limited by what curves, stop lines and safety allow."""
    graph, background, pace = traffic.graph, traffic.background, traffic.pace
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    speed, path = background.speed[row], background.path
    if background.crashed[row]:
        return max(-LARGEST_ACCELERATION, -speed / dt)
    gap, leader_speed = scratch.gap[row], scratch.leader_speed[row]
    target = min(background.desired_speed[row], pace[path[row, 0]])
    acceleration = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
    driven = speed * dt
    allowed = math.inf
    if gap < math.inf:
        allowed = approach_speed(gap - _LEAST_GAP - driven, max(leader_speed, 0.0), LARGEST_ACCELERATION, dt)
        if gap <= _LEAST_GAP:
            allowed = 0.0
    ahead = right_of_way.ahead[row]
    if ahead != NOBODY and right_of_way.granted[row] != ahead:
        line = right_of_way.line_distance[row] - LINE_MARGIN - driven
        allowed = min(allowed, approach_speed(line, 0.0, LINE_BRAKING, dt))
    base = graph.length[path[row, 0]] - background.s[row] - driven
    for place in range(1, PATH_LENGTH):
        if base > LOOK_AHEAD:
            break
        lane = path[row, place]
        if pace[lane] < speed:
            allowed = min(allowed, approach_speed(base, pace[lane], LINE_BRAKING, dt))
        base += graph.length[lane]
    acceleration = min(acceleration, (allowed - speed) / dt, LARGEST_ACCELERATION)
    return max(acceleration, -LARGEST_ACCELERATION, -speed / dt)


@njit(cache=True, nogil=True)
def _move(traffic: Traffic, row: int, dt: float) -> None:
    """Drive on along the path, as highway-env integrates: first the position, then the speed."""
    graph, background, right_of_way = traffic.graph, traffic.background, traffic.right_of_way
    s = background.s[row] + background.speed[row] * dt
    background.speed[row] += background.acceleration[row] * dt
    lane = background.lane[row]
    while s > graph.length[lane]:
        s -= graph.length[lane]
        drop_first(graph, background, row)
        lane = background.path[row, 0]
        movement = graph.movement[lane]
        if movement >= 0 and right_of_way.crossing[row] != movement:
            right_of_way.crossing[row] = movement
            right_of_way.granted[row] = NOBODY
    if graph.movement[lane] < 0 and s > 0.5 * background.length[row]:
        right_of_way.crossing[row] = NOBODY
    background.lane[row], background.s[row] = lane, s
    background.x[row], background.y[row], background.heading[row] = lane_pose(graph, lane, s)
