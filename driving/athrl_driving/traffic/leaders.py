"""Finds the leader on a vehicle's path, and the next movement on it, compiled."""

import math

from athrl_driving.kernels.compilation import part, spliced
from athrl_driving.traffic.columns import NONE, Traffic
from athrl_driving.traffic.lane_links import CURVE_BRAKING
from athrl_driving.traffic.link_queues import vehicle_of

LOOK_AHEAD = 60.0
"""Metres ahead along its path that a vehicle considers."""

LINE_MARGIN = 0.5
"""Metres between a waiting vehicle's front and the stop line."""

_GAP_TO_LET_IN = 3.0
_STANDSTILL_ROOM = 2.0
_REACTION_ROOM = 1.0


@part
def look_ahead(traffic: Traffic, vehicle: int, length: float, speed: float) -> None:
    """Find and note the leader and the next movement of a vehicle (N: the ego) of `length` m.

    The leader is the nearest of: vehicles on the links of the path, vehicles on diverging movements whose
    rear has not left the path yet, vehicles on merging movements, and the ego where it covers a link of the
    path.
    """
    covered, path, right_of_way = traffic.ego_on_links, traffic.background.path, traffic.right_of_way
    is_ego = vehicle == path.shape[0]
    gap, leader_speed, leader, leader_middle = math.inf, 0.0, NONE, math.inf
    ahead, line = NONE, math.inf
    base = 0.0 if is_ego else -traffic.scratch.position[vehicle]
    until = math.inf
    places = covered.path_link.shape[0] if is_ego else path.shape[1]
    for place in range(places):
        if is_ego:
            link, base, until = covered.path_link[place], covered.path_base[place], covered.path_until[place]
        else:
            link = path[vehicle, place]
        if link < 0 or base > LOOK_AHEAD:
            break
        if place > 0 and link < right_of_way.holders.shape[0] and ahead == NONE:
            ahead, line = link, base - 0.5 * length
        if leader == NONE:
            leader, leader_middle, gap, leader_speed = _leader_on(
                traffic, vehicle, place, link, base, until, length, speed
            )
        base += traffic.lane_links.length[link]
        if leader != NONE and ahead != NONE:
            break
    _note(traffic, vehicle, gap, leader_speed, ahead, line)
    # A vehicle behind a leader without a grant does not request one itself.
    before_line = leader != NONE and leader_middle < line + 0.5 * length
    traffic.scratch.held_up[vehicle] = before_line and right_of_way.granted[leader] == NONE


@spliced
def _note(traffic: Traffic, vehicle: int, gap: float, leader_speed: float, ahead: int, line: float) -> None:
    """Note gap (m) and speed (m/s) of the leader, and the next movement with the distance (m) to its line."""
    traffic.scratch.gap[vehicle], traffic.scratch.leader_speed[vehicle] = gap, leader_speed
    traffic.right_of_way.ahead[vehicle], traffic.right_of_way.line_distance[vehicle] = ahead, line


@spliced
def _leader_on(
    traffic: Traffic,
    vehicle: int,
    place: int,
    link: int,
    base: float,
    until: float,
    length: float,
    speed: float,
) -> tuple[int, float, float, float]:
    """Return the leader on the link at a place of the path: its index, m to its middle, the gap (m), m/s.

    `base` is the distance (m) to the link's start. Without a leader: -1, inf, inf, 0.
    """
    background, covered = traffic.background, traffic.ego_on_links
    vehicles = background.lane.shape[0]
    gap, leader_speed = math.inf, 0.0
    leader, middle = _vehicle_on(traffic, vehicle, place, link, base, until, length, speed)
    if leader != NONE:
        gap = middle - 0.5 * (length + background.length[leader])
        leader_speed = background.speed[leader]
    if vehicle < vehicles and covered.rear[link] < math.inf:
        ego_middle = base + 0.5 * (covered.rear[link] + covered.front[link])
        ego_gap = base + covered.rear[link] - 0.5 * length
        if ego_middle > 0.0 and ego_gap < gap:
            return vehicles, ego_middle, ego_gap, covered.speed[link]
    return leader, middle, gap, leader_speed


@spliced
def _vehicle_on(
    traffic: Traffic,
    vehicle: int,
    place: int,
    link: int,
    base: float,
    until: float,
    length: float,
    speed: float,
) -> tuple[int, float]:
    """Return the nearest vehicle ahead on a link and on movements that diverge from it or merge with it.

    Also return the distance (m) to its middle; -1 and inf without one.
    """
    scratch, vehicles = traffic.scratch, traffic.background.lane.shape[0]
    leader, middle = NONE, math.inf
    entry = scratch.following[vehicle] if place == 0 and vehicle < vehicles else scratch.first[link]
    entry = _first_ahead(traffic, entry, vehicle, base, until, length, speed)
    if entry != NONE:
        leader, middle = vehicle_of(entry, vehicles), base + scratch.position[entry]
    if link >= traffic.right_of_way.holders.shape[0]:
        return leader, middle
    entry = _diverging(traffic, link, base, middle)
    if entry != NONE:
        leader, middle = entry, base + scratch.position[entry]
    entry, nearer = _merging(traffic, link, base, middle, vehicle)
    if entry != NONE:
        leader, middle = entry, nearer
    return leader, middle


@part
def _first_ahead(
    traffic: Traffic, entry: int, vehicle: int, base: float, until: float, length: float, speed: float
) -> int:
    """Return the first entry from `entry` on that is ahead and, if it requests a gap, can still be let in."""
    scratch, requests_gap = traffic.scratch, traffic.lane_changes.requests_gap
    vehicles = requests_gap.shape[0]
    while entry != NONE:
        position = scratch.position[entry]
        if position >= until:
            return NONE
        middle = base + position
        if vehicle_of(entry, vehicles) != vehicle and middle > 0.0:
            if entry < vehicles or not requests_gap[entry - vehicles]:
                return entry
            room = middle - length - _GAP_TO_LET_IN
            if vehicle < vehicles and room > speed * speed / (2.0 * CURVE_BRAKING):
                return entry
        entry = scratch.following[entry]
    return NONE


@part
def _diverging(traffic: Traffic, movement: int, base: float, nearer_than: float) -> int:
    """Return the nearest vehicle ahead on a sibling movement whose rear still overlaps `movement`.

    `base` is the distance (m) to where the movements start.
    """
    movements, scratch, lengths = traffic.movements, traffic.scratch, traffic.background.length
    found = NONE
    for index in range(movements.sibling_start[movement], movements.sibling_start[movement + 1]):
        entry = scratch.first[movements.sibling[index]]
        while entry != NONE:
            middle = base + scratch.position[entry]
            if middle >= nearer_than:
                break
            if middle > 0.0 and scratch.position[entry] - 0.5 * lengths[entry] < movements.shared[index]:
                found, nearer_than = entry, middle
                break
            entry = scratch.following[entry]
    return found


@part
def _merging(
    traffic: Traffic, movement: int, base: float, nearer_than: float, vehicle: int
) -> tuple[int, float]:
    """Return the nearest vehicle ahead on movements that merge with `movement`, and its distance (m)."""
    conflict_zones, scratch, lengths = traffic.conflict_zones, traffic.scratch, traffic.background.length
    found = NONE
    for index in range(conflict_zones.merge_start[movement], conflict_zones.merge_start[movement + 1]):
        entry = scratch.first[conflict_zones.merged[index]]
        while entry != NONE:
            position = scratch.position[entry]
            middle = base + position + conflict_zones.merged_shift[index]
            if middle >= nearer_than or position - 0.5 * lengths[entry] > conflict_zones.merged_until[index]:
                break
            if middle > 0.0 and position > conflict_zones.merged_begin[index] and entry != vehicle:
                found, nearer_than = entry, middle
                break
            entry = scratch.following[entry]
    return found, nearer_than


@part
def stopping_speed(traffic: Traffic, vehicle: int) -> float:
    """Return the speed (m/s) from which a vehicle can still stop behind its leader and before its line."""
    background, lane_links, scratch = traffic.background, traffic.lane_links, traffic.scratch
    line = traffic.right_of_way.line_distance[vehicle] - LINE_MARGIN
    end = (
        lane_links.room[background.path[vehicle, 0]]
        - scratch.position[vehicle]
        - 0.5 * background.length[vehicle]
    )
    room = max(min(scratch.gap[vehicle] - _STANDSTILL_ROOM, line, end) - _REACTION_ROOM, 0.0)
    return math.sqrt(2.0 * CURVE_BRAKING * room)


@part
def look_beside(traffic: Traffic, vehicle: int, length: float) -> None:
    """Find the leader of a changing vehicle on the lane that it has not left yet."""
    background, scratch, covered = traffic.background, traffic.scratch, traffic.ego_on_links
    vehicles = background.lane.shape[0]
    entry = vehicles + vehicle
    gap, leader_speed = math.inf, 0.0
    link = scratch.link[entry]
    if link != NONE and not traffic.lane_changes.requests_gap[vehicle]:
        position = scratch.position[entry]
        other = scratch.following[entry]
        while other != NONE and (
            vehicle_of(other, vehicles) == vehicle
            or (other >= vehicles and traffic.lane_changes.requests_gap[other - vehicles])
        ):
            other = scratch.following[other]
        if other != NONE:
            leader = vehicle_of(other, vehicles)
            gap = scratch.position[other] - position - 0.5 * (length + background.length[leader])
            leader_speed = background.speed[leader]
        if covered.rear[link] < math.inf and 0.5 * (covered.rear[link] + covered.front[link]) > position:
            ego_gap = covered.rear[link] - position - 0.5 * length
            if ego_gap < gap:
                gap, leader_speed = ego_gap, covered.speed[link]
    scratch.side_gap[vehicle], scratch.side_speed[vehicle] = gap, leader_speed
