"""One tick of the traffic: lane changes begin, vehicles look ahead, requests are granted, all vehicles move.

At the edge of an open map vehicles leave and enter before that (see `map_edge`). Background vehicles drive
along the centre line of their lane, or on a smooth curve to it from the lane beside. All decisions see the
state before the tick.
"""

import math

from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import entry, part
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.traffic.columns import NONE, Traffic
from athrl_driving.traffic.crossing_order import distance_to_conflict_zone
from athrl_driving.traffic.ego import cover_links, follow_path, note_crossing, uncover_links
from athrl_driving.traffic.ego_columns import LENGTH, PRESENT, SPEED
from athrl_driving.traffic.geometry import lane_elevation, lane_pose
from athrl_driving.traffic.idm import (
    LARGEST_ACCELERATION,
    REFERENCE_LENGTH,
    approach_speed,
    idm_acceleration,
)
from athrl_driving.traffic.lane_changes import change_lanes, shift
from athrl_driving.traffic.lane_links import CURVE_BRAKING
from athrl_driving.traffic.leaders import LINE_MARGIN, look_ahead, look_beside
from athrl_driving.traffic.link_queues import fill_link_queues
from athrl_driving.traffic.map_edge import cross_edge
from athrl_driving.traffic.paths import drop_first
from athrl_driving.traffic.right_of_way import count_holders, grant, request
from athrl_driving.traffic.state import environment_traffic

CONFLICT_MARGIN = 0.3
"""Metres kept to the start of a conflict zone that another vehicle passes first."""

_LEAST_GAP = 1.0


@entry
def tick(traffic: Traffic, e: int, ego: Floats, ego_path: Integers, dt: float) -> None:
    """Advance environment `e`, or with 0 s let its ego find its leader; for calls from Python."""
    own = by_reference(environment_traffic(by_reference(traffic), e))
    if dt > 0.0:
        advance(own, ego, ego_path, dt)
    else:
        find_leader(own, ego, ego_path)


@part
def advance(traffic: Traffic, ego: Floats, ego_path: Integers, dt: float) -> None:
    """Move one environment's background vehicles by `dt` seconds; with 0 they only find leaders and lines.

    `traffic` is a view without the environment axis, by reference, and so is all that it holds: with one type
    it is compiled once for all kernels. `ego` is float64 [8] (see `ego_columns`). `ego_path` holds lanes of
    the lane graph that the ego will drive, its present one among the first, padded with -1.
    """
    background, changes = traffic.background, traffic.lane_changes
    vehicles = background.lane.shape[0]
    _note_places(traffic, ego, ego_path)
    if dt > 0.0:
        if traffic.lane_links.entries.shape[0] > 0:
            cross_edge(traffic, ego)
        change_lanes(traffic, ego)
    for vehicle in range(vehicles + 1):
        length, speed = ego[LENGTH], ego[SPEED]
        if vehicle < vehicles:
            length, speed = background.length[vehicle], background.speed[vehicle]
            if changes.distance[vehicle] > 0.0:
                look_beside(traffic, vehicle, length)
        look_ahead(traffic, vehicle, length, speed)
    if dt == 0.0:
        return
    for vehicle in range(vehicles + 1):
        request(traffic, vehicle, background.speed[vehicle] if vehicle < vehicles else ego[SPEED])
    count_holders(traffic)
    grant(traffic)
    _accelerate(traffic, dt)
    _move(traffic, dt)
    traffic.scratch.clock[0] += dt


@part
def find_leader(traffic: Traffic, ego: Floats, ego_path: Integers) -> None:
    """Find the ego's leader and line where all vehicles are now; arguments as of `advance`.

    What the others saw in the last tick stays: they decide by it in the next one.
    """
    _note_places(traffic, ego, ego_path)
    look_ahead(traffic, traffic.background.lane.shape[0], ego[LENGTH], ego[SPEED])


@part
def _note_places(traffic: Traffic, ego: Floats, ego_path: Integers) -> None:
    """Enter all vehicles on their links, and note the links that the ego covers and will drive."""
    background, covered = traffic.background, traffic.ego_on_links
    fill_link_queues(traffic.graph, traffic.lane_links, background, traffic.lane_changes, traffic.scratch)
    uncover_links(covered)
    covered.path_link[0] = NONE
    if ego[PRESENT] > 0.0:
        cover_links(traffic.graph, traffic.lane_links, covered, ego)
        follow_path(traffic.graph, traffic.lane_links, covered, ego, ego_path)
        note_crossing(traffic.right_of_way, covered, background.lane.shape[0], ego[LENGTH])
    else:
        traffic.right_of_way.crossing[background.lane.shape[0]] = NONE


@part
def _accelerate(traffic: Traffic, dt: float) -> None:
    """Set each vehicle's car-following acceleration, limited by what curves, stop lines and safety allow."""
    background, right_of_way, scratch, lane_links = (
        traffic.background,
        traffic.right_of_way,
        traffic.scratch,
        traffic.lane_links,
    )
    for vehicle in range(background.speed.shape[0]):
        speed, lane = background.speed[vehicle], background.lane[vehicle]
        target = min(background.desired_speed[vehicle], lane_links.pace[lane])
        gap, leader_speed = scratch.gap[vehicle], scratch.leader_speed[vehicle]
        acceleration = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
        allowed = _allowed_behind(gap, leader_speed, speed, dt)
        if traffic.lane_changes.distance[vehicle] > 0.0 and scratch.side_gap[vehicle] < math.inf:
            gap, leader_speed = scratch.side_gap[vehicle], scratch.side_speed[vehicle]
            beside = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
            acceleration = min(acceleration, beside)
            allowed = min(allowed, _allowed_behind(gap, leader_speed, speed, dt))
        ahead = right_of_way.ahead[vehicle]
        if ahead != NONE and right_of_way.granted[vehicle] != ahead:
            line = right_of_way.line_distance[vehicle] - LINE_MARGIN - speed * dt
            allowed = min(allowed, approach_speed(line, 0.0, CURVE_BRAKING, dt))
        allowed = min(allowed, _allowed_at_conflict_zones(traffic, vehicle, speed, dt))
        if background.crashed[vehicle]:
            allowed = 0.0
        allowed = min(allowed, _allowed_by_the_road(traffic, vehicle, lane, speed, dt))
        acceleration = min(acceleration, (allowed - speed) / dt, LARGEST_ACCELERATION)
        background.acceleration[vehicle] = max(acceleration, -LARGEST_ACCELERATION, -speed / dt)


@part
def _allowed_behind(gap: float, leader_speed: float, speed: float, dt: float) -> float:
    """Return the greatest next speed (m/s) that lets a vehicle stop behind a leader that brakes hard."""
    if gap <= _LEAST_GAP:
        return 0.0
    if gap == math.inf:
        return math.inf
    return approach_speed(gap - _LEAST_GAP - speed * dt, max(leader_speed, 0.0), LARGEST_ACCELERATION, dt)


@part
def _allowed_at_conflict_zones(traffic: Traffic, vehicle: int, speed: float, dt: float) -> float:
    """Return the greatest next speed (m/s) before conflict zones that other vehicles pass first."""
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    distance = math.inf
    movement = right_of_way.granted[vehicle]
    if movement != NONE:
        base = right_of_way.line_distance[vehicle] + 0.5 * traffic.background.length[vehicle]
        distance = distance_to_conflict_zone(
            traffic, vehicle, movement, base, right_of_way.grant_number[vehicle]
        )
    movement = scratch.link[vehicle]
    if movement < traffic.lane_links.arrival_penalty.shape[0]:
        number = right_of_way.crossing_number[vehicle]
        distance = min(
            distance,
            distance_to_conflict_zone(traffic, vehicle, movement, -scratch.position[vehicle], number),
        )
    if distance == math.inf:
        return math.inf
    return approach_speed(distance - CONFLICT_MARGIN - speed * dt, 0.0, LARGEST_ACCELERATION, dt)


@part
def _allowed_by_the_road(traffic: Traffic, vehicle: int, lane: int, speed: float, dt: float) -> float:
    """Return the greatest next speed (m/s) for curves within braking distance, dead ends and the edge."""
    background, lane_links = traffic.background, traffic.lane_links
    link, place = lane_links.link[lane], lane_links.place[lane]
    driven = speed * dt
    braking = speed * speed / (2.0 * CURVE_BRAKING) + driven
    allowed = math.inf
    base = traffic.graph.length[lane] - background.s[vehicle] - driven
    if place + 1 < lane_links.lane_start[link + 1] and base < braking:
        entry_speed = lane_links.entry_speed[lane_links.lanes[place + 1]]
        if entry_speed < speed:
            allowed = min(allowed, approach_speed(base, entry_speed, CURVE_BRAKING, dt))
    at = lane_links.link_offset[lane] + background.s[vehicle]
    base = lane_links.length[link] - at - driven
    if lane_links.room[link] < lane_links.length[link] and traffic.right_of_way.entry[vehicle] == NONE:
        front = lane_links.room[link] - at - 0.5 * background.length[vehicle] - driven
        allowed = min(allowed, approach_speed(front, 0.0, CURVE_BRAKING, dt))
    for index in range(1, background.path.shape[1]):
        link = background.path[vehicle, index]
        if base > braking or link == NONE:
            break
        entry_speed = lane_links.entry_speed[lane_links.lanes[lane_links.lane_start[link]]]
        if entry_speed < speed:
            allowed = min(allowed, approach_speed(base, entry_speed, CURVE_BRAKING, dt))
        base += lane_links.length[link]
    return allowed


@part
def _move(traffic: Traffic, dt: float) -> None:
    """Move the vehicles along their paths, integrated as highway-env does: first position, then speed."""
    background, lane_links, graph = traffic.background, traffic.lane_links, traffic.graph
    right_of_way, changes = traffic.right_of_way, traffic.lane_changes
    for vehicle in range(background.lane.shape[0]):
        driven = background.speed[vehicle] * dt
        s, lane = background.s[vehicle] + driven, background.lane[vehicle]
        # Braking to a stop exactly may be rounded to a speed just below 0.
        background.speed[vehicle] = max(
            0.0, background.speed[vehicle] + background.acceleration[vehicle] * dt
        )
        while s > graph.length[lane]:
            following = lane_links.place[lane] + 1
            if following < lane_links.lane_start[lane_links.link[lane] + 1]:
                s -= graph.length[lane]
                lane = lane_links.lanes[following]
                continue
            link = background.path[vehicle, 1]
            if link == NONE:
                s = graph.length[lane]
                break
            s -= graph.length[lane]
            drop_first(lane_links, background, vehicle)
            lane = lane_links.lanes[lane_links.lane_start[link]]
            if link < lane_links.arrival_penalty.shape[0]:
                right_of_way.crossing[vehicle] = link
                right_of_way.crossing_number[vehicle] = right_of_way.grant_number[vehicle]
                right_of_way.granted[vehicle] = NONE
        link = lane_links.link[lane]
        if (
            link >= lane_links.arrival_penalty.shape[0]
            and lane_links.link_offset[lane] + s > 0.5 * background.length[vehicle]
        ):
            right_of_way.crossing[vehicle] = NONE
        background.lane[vehicle], background.s[vehicle] = lane, s
        x, y, heading = lane_pose(graph, lane, s)
        if changes.distance[vehicle] > 0.0:
            angle = shift(traffic, vehicle, driven)
            x -= background.offset[vehicle] * math.sin(heading)
            y += background.offset[vehicle] * math.cos(heading)
            heading += angle
        background.x[vehicle], background.y[vehicle], background.heading[vehicle] = x, y, heading
        background.elevation[vehicle] = lane_elevation(graph, lane, s)
