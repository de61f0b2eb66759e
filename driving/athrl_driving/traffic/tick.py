"""One tick of the traffic: some begin to change lanes, everybody looks, the junctions are served, all move.

Background vehicles drive on rails: along the centre line of their link, or on their way to it from the link
beside. All decisions see the state before the tick.
"""

import math

from athrl_driving.by_reference import by_reference
from athrl_driving.compilation import compiled, inner, part
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.traffic.columns import NOBODY, Traffic
from athrl_driving.traffic.ego import cover_links, follow_path, forget_ego, note_crossing
from athrl_driving.traffic.following import (
    LARGEST_ACCELERATION,
    REFERENCE_LENGTH,
    approach_speed,
    idm_acceleration,
)
from athrl_driving.traffic.geometry import lane_elevation, lane_pose
from athrl_driving.traffic.lane_changes import change_lanes, shift
from athrl_driving.traffic.leaders import look_ahead, look_beside
from athrl_driving.traffic.nodes import sort_onto_links
from athrl_driving.traffic.paths import drop_first
from athrl_driving.traffic.rails import CURVE_BRAKING
from athrl_driving.traffic.right_of_way import ask, count_holders, serve
from athrl_driving.traffic.state import environment_traffic
from athrl_driving.traffic.turns import way_to_a_meeting

LINE_MARGIN = 0.5
"""Metres between a waiting vehicle's front and the stop line."""

MEETING_MARGIN = 0.3
"""Metres kept to where the way of somebody who goes first begins."""

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
    _advance(by_reference(traffic), ego, ego_path, dt)


@part
def _advance(traffic: Traffic, ego: Floats, ego_path: Integers, dt: float) -> None:
    background, changes, covered = traffic.background, traffic.lane_changes, traffic.ego_on_links
    vehicles = background.lane.shape[0]
    present = ego[7] > 0.0
    sort_onto_links(traffic.graph, traffic.rails, background, changes, traffic.scratch)
    forget_ego(covered)
    covered.path_link[0] = NOBODY
    if present:
        cover_links(traffic.graph, traffic.rails, covered, ego)
        follow_path(traffic.graph, traffic.rails, covered, ego, ego_path)
        note_crossing(traffic.right_of_way, covered, vehicles, ego[4])
    else:
        traffic.right_of_way.crossing[vehicles] = NOBODY
    if dt > 0.0:
        change_lanes(traffic, ego)
    for row in range(vehicles + 1):
        length, speed = ego[4], ego[3]
        if row < vehicles:
            length, speed = background.length[row], background.speed[row]
            if changes.over[row] > 0.0:
                look_beside(traffic, row, length)
        look_ahead(traffic, row, length, speed)
    if dt == 0.0:
        return
    for row in range(vehicles + 1):
        ask(traffic, row, background.speed[row] if row < vehicles else ego[3])
    count_holders(traffic)
    serve(traffic)
    _accelerate(traffic, dt)
    _move(traffic, dt)
    traffic.scratch.clock[0] += dt


@part
def _accelerate(traffic: Traffic, dt: float) -> None:
    """Set everybody's car-following acceleration, limited by what curves, stop lines and safety allow."""
    background, right_of_way, scratch, rails = (
        traffic.background,
        traffic.right_of_way,
        traffic.scratch,
        traffic.rails,
    )
    for row in range(background.speed.shape[0]):
        speed, lane = background.speed[row], background.lane[row]
        target = min(background.desired_speed[row], rails.pace[lane])
        gap, leader_speed = scratch.gap[row], scratch.leader_speed[row]
        acceleration = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
        allowed = _allowed_behind(gap, leader_speed, speed, dt)
        if traffic.lane_changes.over[row] > 0.0 and scratch.side_gap[row] < math.inf:
            gap, leader_speed = scratch.side_gap[row], scratch.side_speed[row]
            beside = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
            acceleration = min(acceleration, beside)
            allowed = min(allowed, _allowed_behind(gap, leader_speed, speed, dt))
        ahead = right_of_way.ahead[row]
        if ahead != NOBODY and right_of_way.granted[row] != ahead:
            line = right_of_way.line_distance[row] - LINE_MARGIN - speed * dt
            allowed = min(allowed, approach_speed(line, 0.0, CURVE_BRAKING, dt))
        allowed = min(allowed, _allowed_at_meetings(traffic, row, speed, dt))
        if background.crashed[row]:
            allowed = 0.0
        allowed = min(allowed, _allowed_by_the_road(traffic, row, lane, speed, dt))
        acceleration = min(acceleration, (allowed - speed) / dt, LARGEST_ACCELERATION)
        background.acceleration[row] = max(acceleration, -LARGEST_ACCELERATION, -speed / dt)


@part
def _allowed_behind(gap: float, leader_speed: float, speed: float, dt: float) -> float:
    """Return the greatest next speed (m/s) that lets a vehicle stop behind a leader that brakes hard."""
    if gap <= _LEAST_GAP:
        return 0.0
    if gap == math.inf:
        return math.inf
    return approach_speed(gap - _LEAST_GAP - speed * dt, max(leader_speed, 0.0), LARGEST_ACCELERATION, dt)


@part
def _allowed_at_meetings(traffic: Traffic, row: int, speed: float, dt: float) -> float:
    """Return the greatest next speed for the meetings with others whose turn is before the vehicle's."""
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    way = math.inf
    movement = right_of_way.granted[row]
    if movement != NOBODY:
        base = right_of_way.line_distance[row] + 0.5 * traffic.background.length[row]
        way = way_to_a_meeting(traffic, row, movement, base, right_of_way.turn[row])
    movement = scratch.link[row]
    if movement < traffic.rails.later.shape[0]:
        turn = right_of_way.crossing_turn[row]
        way = min(way, way_to_a_meeting(traffic, row, movement, -scratch.position[row], turn))
    if way == math.inf:
        return math.inf
    return approach_speed(way - MEETING_MARGIN - speed * dt, 0.0, LARGEST_ACCELERATION, dt)


@part
def _allowed_by_the_road(traffic: Traffic, row: int, lane: int, speed: float, dt: float) -> float:
    """Return the greatest next speed for the curves within braking distance, and for a lane's end."""
    background, rails = traffic.background, traffic.rails
    link, place = rails.link[lane], rails.place[lane]
    driven = speed * dt
    braking = speed * speed / (2.0 * CURVE_BRAKING) + driven
    allowed = math.inf
    base = traffic.graph.length[lane] - background.s[row] - driven
    if place + 1 < rails.row_start[link + 1] and base < braking:
        entry = rails.entry_speed[rails.rows[place + 1]]
        if entry < speed:
            allowed = min(allowed, approach_speed(base, entry, CURVE_BRAKING, dt))
    at = rails.link_offset[lane] + background.s[row]
    base = rails.length[link] - at - driven
    if rails.room[link] < rails.length[link]:
        front = rails.room[link] - at - 0.5 * background.length[row] - driven
        allowed = min(allowed, approach_speed(front, 0.0, CURVE_BRAKING, dt))
    for index in range(1, background.path.shape[1]):
        link = background.path[row, index]
        if base > braking or link == NOBODY:
            break
        entry = rails.entry_speed[rails.rows[rails.row_start[link]]]
        if entry < speed:
            allowed = min(allowed, approach_speed(base, entry, CURVE_BRAKING, dt))
        base += rails.length[link]
    return allowed


@part
def _move(traffic: Traffic, dt: float) -> None:
    """Drive on along the paths, as highway-env integrates: first the position, then the speed."""
    background, rails, graph = traffic.background, traffic.rails, traffic.graph
    right_of_way, changes = traffic.right_of_way, traffic.lane_changes
    for row in range(background.lane.shape[0]):
        driven = background.speed[row] * dt
        s, lane = background.s[row] + driven, background.lane[row]
        background.speed[row] += background.acceleration[row] * dt
        while s > graph.length[lane]:
            following = rails.place[lane] + 1
            if following < rails.row_start[rails.link[lane] + 1]:
                s -= graph.length[lane]
                lane = rails.rows[following]
                continue
            link = background.path[row, 1]
            if link == NOBODY:
                s = graph.length[lane]
                break
            s -= graph.length[lane]
            drop_first(rails, background, row)
            lane = rails.rows[rails.row_start[link]]
            if link < rails.later.shape[0]:
                right_of_way.crossing[row] = link
                right_of_way.crossing_turn[row] = right_of_way.turn[row]
                right_of_way.granted[row] = NOBODY
        link = rails.link[lane]
        if link >= rails.later.shape[0] and rails.link_offset[lane] + s > 0.5 * background.length[row]:
            right_of_way.crossing[row] = NOBODY
        background.lane[row], background.s[row] = lane, s
        x, y, heading = lane_pose(graph, lane, s)
        if changes.over[row] > 0.0:
            angle = shift(traffic, row, driven)
            x -= background.offset[row] * math.sin(heading)
            y += background.offset[row] * math.cos(heading)
            heading += angle
        background.x[row], background.y[row], background.heading[row] = x, y, heading
        background.elevation[row] = lane_elevation(graph, lane, s)
