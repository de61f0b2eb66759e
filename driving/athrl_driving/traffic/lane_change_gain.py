"""What a lane change is worth, and whether it is safe: MOBIL's rule over links.

A gap is safe where whoever is behind brakes gently at most. A change that brings its vehicle a gain may cost
who is behind there a part of it.
"""

import math

from athrl_driving.compilation import part
from athrl_driving.traffic.columns import NOBODY, Traffic
from athrl_driving.traffic.following import REFERENCE_LENGTH, approach_speed, idm_acceleration
from athrl_driving.traffic.nodes import owner
from athrl_driving.traffic.rails import CURVE_BRAKING

POLITENESS = 0.3
"""How much the loss of the vehicle behind counts beside one's own gain."""

GENTLE_BRAKING = 2.5
"""m/s2 that a change may ask of whoever is behind."""

BEHIND_A_JUNCTION = 45.0
"""Metres from a junction's exit that are kept for those who come out of it."""

_LEAST_GAP = 2.0
_GAP_TIME = 0.3
_GAP_MARGIN = 1.5
_ROOM_AT_THE_LINE = 0.6


@part
def gain_of_change(
    traffic: Traffic, row: int, lane: int, other: int, side: int, distance: float, needed: bool
) -> float:
    """Return what a change gains (m/s2, as MOBIL counts); minus infinity where it is not safe."""
    background, graph, rails = traffic.background, traffic.graph, traffic.rails
    s = background.s[row] * graph.length[other] / graph.length[lane]
    link, position = rails.link[other], rails.link_offset[other] + s
    if not _has_room(traffic, row, other, s, side, distance, needed):
        return -math.inf
    speed, length = background.speed[row], background.length[row]
    behind, ahead = _neighbours(traffic, link, position)
    gap, leader_speed = _gap_ahead(traffic, ahead, link, position, length)
    if not _is_safe(gap, speed, leader_speed):
        return -math.inf
    follower, follower_gap = _gap_behind(traffic, behind, link, position, length)
    if follower == NOBODY:
        if follower_gap < math.inf:
            return -math.inf
    elif not _is_safe(follower_gap, background.speed[follower], speed):
        return -math.inf
    if needed:
        return math.inf
    gain = _own_gain(traffic, row, lane, gap, leader_speed)
    if follower != NOBODY:
        whole_gap = follower_gap + length + gap
        gain += POLITENESS * _gain_behind(traffic, follower, follower_gap, speed, whole_gap, leader_speed)
    return gain


@part
def _has_room(
    traffic: Traffic, row: int, other: int, s: float, side: int, distance: float, needed: bool
) -> bool:
    """Tell whether the map and the ego leave room for a change over `distance` m to `s` m on row `other`."""
    background, rails = traffic.background, traffic.rails
    link, position = rails.link[other], rails.link_offset[other] + s
    # Behind the change there has to be room to stop at the line.
    room = rails.length[link] - position - 0.5 * background.length[row] - distance
    if room < _ROOM_AT_THE_LINE + background.speed[row] ** 2 / (2.0 * CURVE_BRAKING):
        return False
    if not _goes_on_beside(traffic, link, other, s, traffic.scratch.link[row], side, distance):
        return False
    if position < BEHIND_A_JUNCTION and traffic.right_of_way.inbound[link] > 0:
        return False
    return needed or traffic.ego_on_links.rear[link] == math.inf


@part
def _neighbours(traffic: Traffic, link: int, position: float) -> tuple[int, int]:
    """Return the nodes behind and ahead of a place on a link, -1 where there are none."""
    scratch = traffic.scratch
    behind, ahead = scratch.last[link], NOBODY
    while behind != NOBODY and (scratch.position[behind] > position or _only_asks(traffic, behind)):
        if not _only_asks(traffic, behind):
            ahead = behind
        behind = scratch.preceding[behind]
    return behind, ahead


@part
def _gap_ahead(
    traffic: Traffic, ahead: int, link: int, position: float, length: float
) -> tuple[float, float]:
    """Return gap and speed of node `ahead` or, without it, of the nearest vehicle on the links after."""
    background, scratch = traffic.background, traffic.scratch
    if ahead == NOBODY:
        return _beyond(traffic, link, position, length)
    leader = owner(ahead, background.lane.shape[0])
    gap = scratch.position[ahead] - position - 0.5 * (length + background.length[leader])
    return gap, background.speed[leader]


@part
def _gap_behind(
    traffic: Traffic, behind: int, link: int, position: float, length: float
) -> tuple[int, float]:
    """Return the vehicle of node `behind` or, without it, the nearest on the links before, and its gap."""
    background, scratch = traffic.background, traffic.scratch
    if behind == NOBODY:
        return _before(traffic, link, position, length)
    follower = owner(behind, background.lane.shape[0])
    return follower, position - scratch.position[behind] - 0.5 * (length + background.length[follower])


@part
def _own_gain(traffic: Traffic, row: int, lane: int, gap: float, leader_speed: float) -> float:
    """Return how much more (m/s2) a vehicle could accelerate behind another leader."""
    background, scratch = traffic.background, traffic.scratch
    speed, target = background.speed[row], min(background.desired_speed[row], traffic.rails.pace[lane])
    gain = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
    return gain - idm_acceleration(
        speed, target, scratch.gap[row] + REFERENCE_LENGTH, scratch.leader_speed[row]
    )


@part
def _gain_behind(
    traffic: Traffic, follower: int, gap: float, speed: float, whole_gap: float, leader_speed: float
) -> float:
    """Return how much more (m/s2) a follower could accelerate with somebody `gap` m ahead at `speed`."""
    own, target = traffic.background.speed[follower], traffic.background.desired_speed[follower]
    before = idm_acceleration(own, target, whole_gap + REFERENCE_LENGTH, leader_speed)
    after = idm_acceleration(own, target, gap + REFERENCE_LENGTH, speed)
    return after - before


@part
def _only_asks(traffic: Traffic, node: int) -> bool:
    """Tell whether a node is no body but a request to be let in."""
    vehicles = traffic.background.lane.shape[0]
    return node >= vehicles and traffic.lane_changes.asks[node - vehicles]


@part
def _is_safe(gap: float, speed: float, leader_speed: float) -> bool:
    """Tell whether who drives `gap` metres behind a leader has to brake gently at most."""
    if gap == math.inf:
        return True
    if gap < _LEAST_GAP + _GAP_TIME * speed:
        return False
    return speed <= approach_speed(gap - _GAP_MARGIN, max(leader_speed, 0.0), GENTLE_BRAKING, 0.1)


@part
def _goes_on_beside(
    traffic: Traffic, link: int, row: int, s: float, own_link: int, side: int, distance: float
) -> bool:
    """Tell whether both lanes run beside each other for `distance` metres from `s` on `row` of `link`."""
    rails, graph = traffic.rails, traffic.graph
    place = rails.place[row]
    covered = graph.length[row] - s
    while covered < distance:
        place += 1
        if place >= rails.row_start[link + 1]:
            return False
        row = rails.rows[place]
        beside = rails.beside[row, 1 - side]
        if beside < 0 or rails.link[beside] != own_link:
            return False
        covered += graph.length[row]
    return True


@part
def _beyond(traffic: Traffic, link: int, position: float, length: float) -> tuple[float, float]:
    """Return gap and speed of the nearest vehicle on ordinary links after `link`."""
    rails, scratch, background = traffic.rails, traffic.scratch, traffic.background
    gap, speed = math.inf, 0.0
    for index in range(rails.next_start[link], rails.next_start[link + 1]):
        node = scratch.first[rails.next[index]]
        if node == NOBODY:
            continue
        leader = owner(node, background.lane.shape[0])
        distance = rails.length[link] - position + scratch.position[node]
        distance -= 0.5 * (length + background.length[leader])
        if distance < gap:
            gap, speed = distance, background.speed[leader]
    return gap, speed


@part
def _before(traffic: Traffic, link: int, position: float, length: float) -> tuple[int, float]:
    """Return the nearest vehicle on the links before `link` and the gap to it; -1 and inf without one."""
    rails, scratch, background = traffic.rails, traffic.scratch, traffic.background
    follower, gap = NOBODY, math.inf
    for index in range(rails.previous_start[link], rails.previous_start[link + 1]):
        before = rails.previous[index]
        node = scratch.last[before]
        if node == NOBODY:
            continue
        other = owner(node, background.lane.shape[0])
        distance = position + rails.length[before] - scratch.position[node]
        distance -= 0.5 * (length + background.length[other])
        if distance < gap:
            follower, gap = other, distance
    return follower, gap
