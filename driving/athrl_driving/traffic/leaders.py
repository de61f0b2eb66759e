"""Who drives ahead on a vehicle's path, and the next junction on it."""

import math

from athrl_driving.compilation import part, spliced
from athrl_driving.traffic.columns import NOBODY, Traffic
from athrl_driving.traffic.nodes import owner
from athrl_driving.traffic.rails import CURVE_BRAKING

LOOK_AHEAD = 60.0
"""Metres of its path that a vehicle looks at."""

_ROOM_TO_LET_IN = 3.0


@part
def look_ahead(traffic: Traffic, row: int, length: float, speed: float) -> None:
    """Find the leader and the next movement of vehicle `row` (N: the ego), `length` m long, and note them.

    The leader is the nearest of: who is on the links of the path, who is on ways that part from the path and
    has not left it with its rear, and the ego where it covers a link of the path.
    """
    covered, path, right_of_way = traffic.ego_on_links, traffic.background.path, traffic.right_of_way
    is_ego = row == path.shape[0]
    gap, leader_speed, leader, leader_middle = math.inf, 0.0, NOBODY, math.inf
    ahead, line = NOBODY, math.inf
    base = 0.0 if is_ego else -traffic.scratch.position[row]
    until = math.inf
    places = covered.path_link.shape[0] if is_ego else path.shape[1]
    for place in range(places):
        if is_ego:
            link, base, until = covered.path_link[place], covered.path_base[place], covered.path_until[place]
        else:
            link = path[row, place]
        if link < 0 or base > LOOK_AHEAD:
            break
        if place > 0 and link < right_of_way.holders.shape[0] and ahead == NOBODY:
            ahead, line = link, base - 0.5 * length
        if leader == NOBODY:
            leader, leader_middle, gap, leader_speed = _leader_on(
                traffic, row, place, link, base, until, length, speed
            )
        base += traffic.rails.length[link]
        if leader != NOBODY and ahead != NOBODY:
            break
    _note(traffic, row, gap, leader_speed, ahead, line)
    # Who drives behind somebody without a right to cross waits its turn.
    before_line = leader != NOBODY and leader_middle < line + 0.5 * length
    traffic.scratch.held_up[row] = before_line and right_of_way.granted[leader] == NOBODY


@spliced
def _note(traffic: Traffic, row: int, gap: float, leader_speed: float, ahead: int, line: float) -> None:
    """Note the gap (m) to the leader and its speed (m/s), the next movement and the way (m) to its line."""
    traffic.scratch.gap[row], traffic.scratch.leader_speed[row] = gap, leader_speed
    traffic.right_of_way.ahead[row], traffic.right_of_way.line_distance[row] = ahead, line


@spliced
def _leader_on(
    traffic: Traffic,
    row: int,
    place: int,
    link: int,
    base: float,
    until: float,
    length: float,
    speed: float,
) -> tuple[int, float, float, float]:
    """Return the leader on the link at a place of the path: who, and m to its middle and rear, and m/s.

    `base` is the distance (m) to the link's start. Without a leader: -1, inf, inf, 0.
    """
    background, covered = traffic.background, traffic.ego_on_links
    vehicles = background.lane.shape[0]
    gap, leader_speed = math.inf, 0.0
    leader, middle = _vehicle_on(traffic, row, place, link, base, until, length, speed)
    if leader != NOBODY:
        gap = middle - 0.5 * (length + background.length[leader])
        leader_speed = background.speed[leader]
    if row < vehicles and covered.rear[link] < math.inf:
        ego_middle = base + 0.5 * (covered.rear[link] + covered.front[link])
        ego_gap = base + covered.rear[link] - 0.5 * length
        if ego_middle > 0.0 and ego_gap < gap:
            return vehicles, ego_middle, ego_gap, covered.speed[link]
    return leader, middle, gap, leader_speed


@spliced
def _vehicle_on(
    traffic: Traffic,
    row: int,
    place: int,
    link: int,
    base: float,
    until: float,
    length: float,
    speed: float,
) -> tuple[int, float]:
    """Return the nearest vehicle to heed on a link and on the ways that part from it or merge with it.

    With it the distance (m) to its middle; -1 and inf without one.
    """
    scratch, vehicles = traffic.scratch, traffic.background.lane.shape[0]
    leader, middle = NOBODY, math.inf
    node = scratch.following[row] if place == 0 and row < vehicles else scratch.first[link]
    node = _first_to_heed(traffic, node, row, base, until, length, speed)
    if node != NOBODY:
        leader, middle = owner(node, vehicles), base + scratch.position[node]
    if link >= traffic.right_of_way.holders.shape[0]:
        return leader, middle
    node = _parting(traffic, link, base, middle)
    if node != NOBODY:
        leader, middle = node, base + scratch.position[node]
    node, nearer = _merged(traffic, link, base, middle, row)
    if node != NOBODY:
        leader, middle = node, nearer
    return leader, middle


@part
def _first_to_heed(
    traffic: Traffic, node: int, row: int, base: float, until: float, length: float, speed: float
) -> int:
    """Return the first of the nodes from `node` on that is ahead and no request to be let in too late."""
    scratch, asks = traffic.scratch, traffic.lane_changes.asks
    vehicles = asks.shape[0]
    while node != NOBODY:
        position = scratch.position[node]
        if position >= until:
            return NOBODY
        middle = base + position
        if owner(node, vehicles) != row and middle > 0.0:
            if node < vehicles or not asks[node - vehicles]:
                return node
            room = middle - length - _ROOM_TO_LET_IN
            if row < vehicles and room > speed * speed / (2.0 * CURVE_BRAKING):
                return node
        node = scratch.following[node]
    return NOBODY


@part
def _parting(traffic: Traffic, movement: int, base: float, nearer_than: float) -> int:
    """Return the nearest vehicle ahead on a way from the same origin that still covers some of `movement`.

    `base` is the distance (m) to where the ways start.
    """
    movements, scratch, lengths = traffic.movements, traffic.scratch, traffic.background.length
    found = NOBODY
    for index in range(movements.sibling_start[movement], movements.sibling_start[movement + 1]):
        node = scratch.first[movements.sibling[index]]
        while node != NOBODY:
            middle = base + scratch.position[node]
            if middle >= nearer_than:
                break
            if middle > 0.0 and scratch.position[node] - 0.5 * lengths[node] < movements.shared[index]:
                found, nearer_than = node, middle
                break
            node = scratch.following[node]
    return found


@part
def _merged(traffic: Traffic, movement: int, base: float, nearer_than: float, row: int) -> tuple[int, float]:
    """Return the nearest vehicle ahead on ways that have merged with `movement`, and its distance (m)."""
    meetings, scratch, lengths = traffic.meetings, traffic.scratch, traffic.background.length
    found = NOBODY
    for index in range(meetings.merge_start[movement], meetings.merge_start[movement + 1]):
        node = scratch.first[meetings.merged[index]]
        while node != NOBODY:
            position = scratch.position[node]
            middle = base + position + meetings.merged_shift[index]
            if middle >= nearer_than or position - 0.5 * lengths[node] > meetings.merged_until[index]:
                break
            if middle > 0.0 and position > meetings.merged_begin[index] and node != row:
                found, nearer_than = node, middle
                break
            node = scratch.following[node]
    return found, nearer_than


@part
def look_beside(traffic: Traffic, row: int, length: float) -> None:
    """Find the leader of a changing vehicle on the lane that it has not left yet."""
    background, scratch, covered = traffic.background, traffic.scratch, traffic.ego_on_links
    vehicles = background.lane.shape[0]
    node = vehicles + row
    gap, leader_speed = math.inf, 0.0
    link = scratch.link[node]
    if link != NOBODY and not traffic.lane_changes.asks[row]:
        position = scratch.position[node]
        other = scratch.following[node]
        while other != NOBODY and (
            owner(other, vehicles) == row
            or (other >= vehicles and traffic.lane_changes.asks[other - vehicles])
        ):
            other = scratch.following[other]
        if other != NOBODY:
            leader = owner(other, vehicles)
            gap = scratch.position[other] - position - 0.5 * (length + background.length[leader])
            leader_speed = background.speed[leader]
        if covered.rear[link] < math.inf and 0.5 * (covered.rear[link] + covered.front[link]) > position:
            ego_gap = covered.rear[link] - position - 0.5 * length
            if ego_gap < gap:
                gap, leader_speed = ego_gap, covered.speed[link]
    scratch.side_gap[row], scratch.side_speed[row] = gap, leader_speed
