"""One tick of the traffic: everybody looks, the junctions are served, everybody accelerates, everybody moves.

Background vehicles drive on rails: they keep to the centre line of the lanes of their path and change their
speed only. They do not change lanes beside each other; where a street has two lanes, the turn before it
decides which one they take. All decisions see the state before the tick.
"""

import math

from athrl_driving.compilation import compiled, inlined, inner
from athrl_driving.maps.geometry import lane_pose
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph
from athrl_driving.traffic.ego import cover_lanes, forget_ego, locate_on_path
from athrl_driving.traffic.following import (
    LARGEST_ACCELERATION,
    REFERENCE_LENGTH,
    approach_speed,
    idm_acceleration,
)
from athrl_driving.traffic.leaders import look_ahead, sort_by_lane
from athrl_driving.traffic.paths import drop_first
from athrl_driving.traffic.right_of_way import LINE_BRAKING, ask, count_holders, serve
from athrl_driving.traffic.state import (
    NOBODY,
    Background,
    RightOfWay,
    Scratch,
    Traffic,
    environment_traffic,
)

LINE_MARGIN = 0.5
"""Metres between a waiting vehicle's front and the stop line."""

_LEAST_GAP = 1.0


@compiled
def tick(traffic: Traffic, e: int, ego: Floats, ego_path: Integers, dt: float) -> None:
    """Let Python call `advance` for environment `e`."""
    advance(environment_traffic(traffic, e), ego, ego_path, dt)


@inner
def advance(traffic: Traffic, ego: Floats, ego_path: Integers, dt: float) -> None:
    """Move one environment's background vehicles on by `dt` seconds; 0 only looks: at leaders and lines.

    `traffic` is a view without the environment axis. `ego` is float64 [8] (see `EGO_FIELDS`). `ego_path`
    holds rows of the lane graph that the ego will drive, its present one among the first, padded with -1.
    """
    graph, movements, background = traffic.graph, traffic.movements, traffic.background
    right_of_way, covered, scratch = traffic.right_of_way, traffic.ego_on_lanes, traffic.scratch
    vehicles = background.lane.shape[0]
    present = ego[7] > 0.0
    sort_by_lane(background, scratch)
    forget_ego(covered)
    if present:
        cover_lanes(graph, covered, ego)
    for row in range(vehicles + 1):
        place, s, length, path = 0, 0.0, 0.0, ego_path
        if row < vehicles:
            path, s, length = background.path[row], background.s[row], background.length[row]
        elif present:
            place, s = locate_on_path(graph, ego, ego_path)
            length = ego[4]
            _note_crossing(graph, right_of_way, row, ego_path, place, s - 0.5 * length)
        else:
            place = NOBODY
        if place < path.shape[0] and place >= 0:
            look_ahead(
                graph, movements, background, right_of_way, covered, scratch,
                row, path, place, s, length, row < vehicles,
            )  # fmt: skip
        else:
            _see_nothing(right_of_way, scratch, row)
    if dt == 0.0:
        return
    for row in range(vehicles):
        ask(right_of_way, scratch, row, background.speed[row])
    ask(right_of_way, scratch, vehicles, ego[3] if present else 0.0)
    count_holders(graph, movements, background, right_of_way)
    serve(graph, movements, background, right_of_way, covered, scratch)
    _accelerate(graph, traffic.pace, background, right_of_way, scratch, dt)
    _move(graph, background, right_of_way, dt)
    scratch.clock[0] += dt


@inlined
def _see_nothing(right_of_way: RightOfWay, scratch: Scratch, row: int) -> None:
    """Note that the ego is off its path."""
    right_of_way.ahead[row] = NOBODY
    right_of_way.line_distance[row] = math.inf
    scratch.gap[row] = math.inf
    scratch.held_up[row] = False


@inlined
def _note_crossing(
    graph: LaneGraph, right_of_way: RightOfWay, row: int, path: Integers, place: int, rear: float
) -> None:
    """Note the movement that the ego is on, until its rear (m along the lane) has left it."""
    movement = graph.movement[path[place]] if place >= 0 else NOBODY
    if movement >= 0:
        right_of_way.crossing[row] = movement
        if right_of_way.granted[row] == movement:
            right_of_way.granted[row] = NOBODY
    elif place < 0 or rear > 0.0:
        right_of_way.crossing[row] = NOBODY


@inlined
def _accelerate(
    graph: LaneGraph,
    pace: Floats,
    background: Background,
    right_of_way: RightOfWay,
    scratch: Scratch,
    dt: float,
) -> None:
    """Set everybody's car-following acceleration, limited by what curves, stop lines and safety allow."""
    paths, lane_length, speeds = background.path, graph.length, background.speed
    for row in range(speeds.shape[0]):
        speed, gap, leader_speed = speeds[row], scratch.gap[row], scratch.leader_speed[row]
        driven = speed * dt
        target = min(background.desired_speed[row], pace[paths[row, 0]])
        acceleration = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
        allowed = math.inf
        if gap <= _LEAST_GAP:
            allowed = 0.0
        elif gap < math.inf:
            distance = gap - _LEAST_GAP - driven
            allowed = approach_speed(distance, max(leader_speed, 0.0), LARGEST_ACCELERATION, dt)
        ahead = right_of_way.ahead[row]
        if ahead != NOBODY and right_of_way.granted[row] != ahead:
            line = right_of_way.line_distance[row] - LINE_MARGIN - driven
            allowed = min(allowed, approach_speed(line, 0.0, LINE_BRAKING, dt))
        if background.crashed[row]:
            allowed = 0.0
        base = lane_length[paths[row, 0]] - background.s[row] - driven
        for place in range(1, paths.shape[1]):
            # Beyond its braking distance no curve matters.
            if base > speed * speed / (2.0 * LINE_BRAKING) + driven:
                break
            lane = paths[row, place]
            if pace[lane] < speed:
                allowed = min(allowed, approach_speed(base, pace[lane], LINE_BRAKING, dt))
            base += lane_length[lane]
        acceleration = min(acceleration, (allowed - speed) / dt, LARGEST_ACCELERATION)
        background.acceleration[row] = max(acceleration, -LARGEST_ACCELERATION, -speed / dt)


@inlined
def _move(graph: LaneGraph, background: Background, right_of_way: RightOfWay, dt: float) -> None:
    """Drive on along the paths, as highway-env integrates: first the position, then the speed."""
    lanes, speeds, lane_length = background.lane, background.speed, graph.length
    for row in range(lanes.shape[0]):
        s = background.s[row] + speeds[row] * dt
        speeds[row] += background.acceleration[row] * dt
        lane = lanes[row]
        while s > lane_length[lane]:
            s -= lane_length[lane]
            drop_first(graph, background, row)
            lane = background.path[row, 0]
            movement = graph.movement[lane]
            if movement >= 0 and right_of_way.crossing[row] != movement:
                right_of_way.crossing[row] = movement
                right_of_way.granted[row] = NOBODY
        if graph.movement[lane] < 0 and s > 0.5 * background.length[row]:
            right_of_way.crossing[row] = NOBODY
        lanes[row], background.s[row] = lane, s
        background.x[row], background.y[row], background.heading[row] = lane_pose(graph, lane, s)
