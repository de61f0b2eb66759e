"""What a lane change gains, and whether it is safe: MOBIL's rule over links, compiled.

A gap is safe where the vehicle behind has to brake with `SAFE_BRAKING` at most. What a change gains is the
own gain of acceleration, and a part of that of the new and of the old vehicle behind (Kesting, Treiber,
Helbing 2007, equation 3).
"""

import math

from athrl_driving.kernels.compilation import part
from athrl_driving.traffic.columns import NONE, Traffic
from athrl_driving.traffic.idm import REFERENCE_LENGTH, approach_speed, idm_acceleration
from athrl_driving.traffic.lane_links import CURVE_BRAKING
from athrl_driving.traffic.link_queues import vehicle_of

POLITENESS = 0.3
"""Weight of what the vehicles behind gain, or lose, relative to the own gain."""

SAFE_BRAKING = 2.5
"""m/s2 with which a change may make the vehicle behind brake."""

CLEAR_BEHIND_JUNCTION = 45.0
"""Metres behind a junction that are kept clear while vehicles are on their way out of it."""

_LEAST_GAP = 2.0
_GAP_TIME = 0.3
_GAP_MARGIN = 1.5
_ROOM_AT_THE_LINE = 0.6
_REACTION_TIME = 0.1
"""Seconds until the vehicle behind brakes."""


@part
def gain_of_change(
    traffic: Traffic, vehicle: int, lane: int, other: int, side: int, distance: float, mandatory: bool
) -> float:
    """Return what a change gains (m/s2, by MOBIL); minus infinity where it is not safe."""
    background, graph, lane_links = traffic.background, traffic.graph, traffic.lane_links
    s = background.s[vehicle] * graph.length[other] / graph.length[lane]
    link, position = lane_links.link[other], lane_links.link_offset[other] + s
    if not _has_room(traffic, vehicle, other, s, side, distance, mandatory):
        return -math.inf
    speed, length = background.speed[vehicle], background.length[vehicle]
    behind, ahead = _neighbours(traffic, link, position)
    gap, leader_speed = _gap_ahead(traffic, ahead, link, position, length)
    if not _is_safe(gap, speed, leader_speed):
        return -math.inf
    follower, follower_gap = _gap_behind(traffic, behind, link, position, length)
    if follower == NONE:
        if follower_gap < math.inf:
            return -math.inf
    elif not _is_safe(follower_gap, background.speed[follower], speed):
        return -math.inf
    if mandatory:
        return math.inf
    gain = _own_gain(traffic, vehicle, lane, gap, leader_speed)
    if follower != NONE:
        whole_gap = follower_gap + length + gap
        gain += POLITENESS * _gain_behind(traffic, follower, whole_gap, leader_speed, follower_gap, speed)
    return gain + POLITENESS * _gain_of_old_follower(traffic, vehicle, speed, length)


@part
def _has_room(
    traffic: Traffic, vehicle: int, other: int, s: float, side: int, distance: float, mandatory: bool
) -> bool:
    """Tell whether the map and the ego leave room for a change over `distance` m to `s` m on lane `other`."""
    background, lane_links = traffic.background, traffic.lane_links
    link, position = lane_links.link[other], lane_links.link_offset[other] + s
    # After the change there has to be room to stop at the line, or for the next change where this lane ends.
    room = lane_links.room[link] - position - 0.5 * background.length[vehicle] - distance
    if room < _ROOM_AT_THE_LINE + background.speed[vehicle] ** 2 / (2.0 * CURVE_BRAKING):
        return False
    if not _runs_alongside(traffic, link, other, s, traffic.scratch.link[vehicle], side, distance):
        return False
    if position < CLEAR_BEHIND_JUNCTION and traffic.right_of_way.inbound[link] > 0:
        return False
    return mandatory or traffic.ego_on_links.rear[link] == math.inf


@part
def _neighbours(traffic: Traffic, link: int, position: float) -> tuple[int, int]:
    """Return the entries behind and ahead of a position on a link, -1 where there is none."""
    scratch = traffic.scratch
    behind, ahead = scratch.last[link], NONE
    while behind != NONE and (scratch.position[behind] > position or _is_request(traffic, behind)):
        if not _is_request(traffic, behind):
            ahead = behind
        behind = scratch.preceding[behind]
    return behind, ahead


@part
def _gap_ahead(
    traffic: Traffic, ahead: int, link: int, position: float, length: float
) -> tuple[float, float]:
    """Return gap and speed of entry `ahead` or, without it, of the nearest vehicle on the next links."""
    background, scratch = traffic.background, traffic.scratch
    if ahead == NONE:
        return _first_on_next_links(traffic, link, position, length)
    leader = vehicle_of(ahead, background.lane.shape[0])
    gap = scratch.position[ahead] - position - 0.5 * (length + background.length[leader])
    return gap, background.speed[leader]


@part
def _gap_behind(
    traffic: Traffic, behind: int, link: int, position: float, length: float
) -> tuple[int, float]:
    """Return the vehicle of entry `behind` or, without it, the nearest on the previous links, and its gap."""
    background, scratch = traffic.background, traffic.scratch
    if behind == NONE:
        return _last_on_previous_links(traffic, link, position, length)
    follower = vehicle_of(behind, background.lane.shape[0])
    return follower, position - scratch.position[behind] - 0.5 * (length + background.length[follower])


@part
def _own_gain(traffic: Traffic, vehicle: int, lane: int, gap: float, leader_speed: float) -> float:
    """Return how much more (m/s2) a vehicle could accelerate behind another leader."""
    background, scratch = traffic.background, traffic.scratch
    speed, target = (
        background.speed[vehicle],
        min(background.desired_speed[vehicle], traffic.lane_links.pace[lane]),
    )
    gain = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
    return gain - idm_acceleration(
        speed, target, scratch.gap[vehicle] + REFERENCE_LENGTH, scratch.leader_speed[vehicle]
    )


@part
def _gain_of_old_follower(traffic: Traffic, vehicle: int, speed: float, length: float) -> float:
    """Return how much more (m/s2) the vehicle behind could accelerate if `vehicle` were gone."""
    scratch = traffic.scratch
    link, position = scratch.link[vehicle], scratch.position[vehicle]
    behind = scratch.preceding[vehicle]
    while behind != NONE and _is_request(traffic, behind):
        behind = scratch.preceding[behind]
    follower, gap = _gap_behind(traffic, behind, link, position, length)
    if follower == NONE:
        return 0.0
    whole_gap = gap + length + scratch.gap[vehicle]
    return _gain_behind(traffic, follower, gap, speed, whole_gap, scratch.leader_speed[vehicle])


@part
def _gain_behind(
    traffic: Traffic,
    follower: int,
    gap: float,
    leader_speed: float,
    gap_after: float,
    leader_speed_after: float,
) -> float:
    """Return how much more (m/s2) a follower could accelerate with another gap (m) to another leader."""
    own, target = traffic.background.speed[follower], traffic.background.desired_speed[follower]
    before = idm_acceleration(own, target, gap + REFERENCE_LENGTH, leader_speed)
    after = idm_acceleration(own, target, gap_after + REFERENCE_LENGTH, leader_speed_after)
    return after - before


@part
def _is_request(traffic: Traffic, entry: int) -> bool:
    """Tell whether an entry is not a body but a request for a gap."""
    vehicles = traffic.background.lane.shape[0]
    return entry >= vehicles and traffic.lane_changes.requests_gap[entry - vehicles]


@part
def _is_safe(gap: float, speed: float, leader_speed: float) -> bool:
    """Tell whether a vehicle `gap` metres behind a leader has to brake with `SAFE_BRAKING` at most."""
    if gap == math.inf:
        return True
    if gap < _LEAST_GAP + _GAP_TIME * speed:
        return False
    return speed <= approach_speed(gap - _GAP_MARGIN, max(leader_speed, 0.0), SAFE_BRAKING, _REACTION_TIME)


@part
def _runs_alongside(
    traffic: Traffic, link: int, lane: int, s: float, own_link: int, side: int, distance: float
) -> bool:
    """Tell whether both lanes run beside each other for `distance` metres from `s` on `lane` of `link`."""
    lane_links, graph = traffic.lane_links, traffic.graph
    place = lane_links.place[lane]
    covered = graph.length[lane] - s
    while covered < distance:
        place += 1
        if place >= lane_links.lane_start[link + 1]:
            return False
        lane = lane_links.lanes[place]
        beside = lane_links.beside[lane, 1 - side]
        if beside < 0 or lane_links.link[beside] != own_link:
            return False
        covered += graph.length[lane]
    return True


@part
def _first_on_next_links(traffic: Traffic, link: int, position: float, length: float) -> tuple[float, float]:
    """Return gap and speed of the nearest vehicle on the links after `link`; inf and 0 without one."""
    lane_links, scratch, background = traffic.lane_links, traffic.scratch, traffic.background
    gap, speed = math.inf, 0.0
    for index in range(lane_links.next_start[link], lane_links.next_start[link + 1]):
        entry = scratch.first[lane_links.next[index]]
        if entry == NONE:
            continue
        leader = vehicle_of(entry, background.lane.shape[0])
        distance = lane_links.length[link] - position + scratch.position[entry]
        distance -= 0.5 * (length + background.length[leader])
        if distance < gap:
            gap, speed = distance, background.speed[leader]
    return gap, speed


@part
def _last_on_previous_links(traffic: Traffic, link: int, position: float, length: float) -> tuple[int, float]:
    """Return the nearest vehicle on the links before `link` and the gap to it; -1 and inf without one."""
    lane_links, scratch, background = traffic.lane_links, traffic.scratch, traffic.background
    follower, gap = NONE, math.inf
    for index in range(lane_links.previous_start[link], lane_links.previous_start[link + 1]):
        before = lane_links.previous[index]
        entry = scratch.last[before]
        if entry == NONE:
            continue
        other = vehicle_of(entry, background.lane.shape[0])
        distance = position + lane_links.length[before] - scratch.position[entry]
        distance -= 0.5 * (length + background.length[other])
        if distance < gap:
            follower, gap = other, distance
    return follower, gap
