"""Right of way at junctions: reservations, first come first served with bounded courtesy, compiled.

A vehicle requests its movement in time to cross without braking. The request is granted when the light is
green or there is none, when no other vehicle holds a conflicting movement, when the ego is not in the way,
and when there is room for the vehicle behind the junction, so that no vehicle stands in a junction and blocks
it. The vehicle that has waited longest comes first, and after `CLAIM_AFTER` no conflicting movement is
granted before it. Requests for movements that yield count as made later (`LaneLinks.arrival_penalty`) and
meanwhile need room for two vehicles behind the junction, so that a roundabout does not fill up. The ego makes
requests like any other vehicle; where it drives without a grant, what it covers counts as taken.
"""

import math

from athrl_driving.kernels.compilation import part
from athrl_driving.kernels.random_numbers import random_below
from athrl_driving.traffic.columns import NONE, Traffic
from athrl_driving.traffic.crossing_order import clears_in_time, exit_of
from athrl_driving.traffic.lane_links import CURVE_BRAKING
from athrl_driving.traffic.link_queues import vehicle_of
from athrl_driving.traffic.paths import plan_from
from athrl_driving.traffic.signals import GREEN, light

SLOT = 10.0
"""Metres of road that a standing vehicle needs behind a junction: its length and a gap."""

DETOUR_AFTER = 8.0
"""Seconds without room on the exit after which a vehicle takes another movement that has room."""

LONG_DETOUR_AFTER = 20.0
"""Seconds of waiting for others after which a vehicle takes another movement that is free."""

GIVE_BACK_AFTER = 6.0
"""Seconds that a vehicle with a grant may stand before the line before it has to request again."""

REQUEST_MARGIN = 15.0
"""Metres before the point where a vehicle would have to brake for the line at which it makes its request."""

CLAIM_AFTER = 25.0
"""Seconds of waiting, beyond the arrival penalty, after which no new conflicting grant is made."""

_FREE, _TAKEN, _TAKEN_BY_EGO = 0, 1, 2


@part
def count_holders(traffic: Traffic) -> None:
    """Count each movement's holders and each exit's inbound vehicles, and find each rearmost holder."""
    right_of_way, lane_links, scratch = traffic.right_of_way, traffic.lane_links, traffic.scratch
    rearmost, holders, inbound = right_of_way.rearmost, right_of_way.holders, right_of_way.inbound
    granted, crossing = right_of_way.granted, right_of_way.crossing
    holders[:] = 0
    inbound[:] = 0
    rearmost[:] = math.inf
    right_of_way.claimed[:] = False
    vehicles = traffic.background.lane.shape[0]
    for vehicle in range(vehicles + 1):
        movement = granted[vehicle]
        if movement >= 0:
            holders[movement] += 1
            inbound[exit_of(traffic, movement)] += 1
            rearmost[movement] = -math.inf
        movement = crossing[vehicle]
        if movement >= 0:
            holders[movement] += 1
            if vehicle == vehicles:
                # The ego may turn back or stop anywhere: it holds the whole movement until it has left.
                inbound[exit_of(traffic, movement)] += 1
                rearmost[movement] = -math.inf
                continue
            rear = scratch.position[vehicle] - 0.5 * traffic.background.length[vehicle]
            if scratch.link[vehicle] == movement:
                inbound[exit_of(traffic, movement)] += 1
            else:
                rear += lane_links.length[movement]
            if rear < rearmost[movement]:
                rearmost[movement] = rear
                right_of_way.rearmost_speed[movement] = traffic.background.speed[vehicle]
    if lane_links.entries.shape[0] > 0:
        for vehicle in range(vehicles):
            entry = right_of_way.entry[vehicle]
            if entry != NONE:
                inbound[lane_links.entries[entry]] += 1


@part
def request(traffic: Traffic, vehicle: int, speed: float) -> None:
    """Let a vehicle that has looked ahead request its next movement, keep its grant, or give it back."""
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    ahead, granted = right_of_way.ahead[vehicle], right_of_way.granted[vehicle]
    if ahead == NONE and granted == NONE:
        right_of_way.waiting_since[vehicle] = math.inf
        return
    now, line = scratch.clock[0], right_of_way.line_distance[vehicle]
    braking = speed * speed / (2.0 * CURVE_BRAKING)
    green = ahead != NONE and light(traffic, ahead) == GREEN
    if granted != NONE:
        idle = speed < 0.1 and line > 0.0 and now - right_of_way.granted_at[vehicle] > GIVE_BACK_AFTER
        stops = not green and line > braking + 1.0
        if idle or stops or granted != ahead:
            granted = NONE
            right_of_way.granted[vehicle] = NONE
    requests = ahead != NONE and granted == NONE and green and not scratch.held_up[vehicle]
    if not requests or line > braking + REQUEST_MARGIN:
        right_of_way.waiting_since[vehicle] = math.inf
    elif right_of_way.waiting_since[vehicle] == math.inf:
        right_of_way.waiting_since[vehicle] = now


@part
def grant(traffic: Traffic) -> None:
    """Grant the requests that can be granted, in order of waiting."""
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    ego = traffic.background.lane.shape[0]
    for index in range(_sort_requests(traffic)):
        vehicle = scratch.order[index]
        movement = right_of_way.ahead[vehicle]
        waited = scratch.clock[0] - right_of_way.waiting_since[vehicle]
        still_penalized = waited < traffic.lane_links.arrival_penalty[movement]
        state = _availability(traffic, vehicle, movement)
        if state != _FREE:
            # A vehicle that waits for the ego, which may stand without end, keeps no other from crossing.
            right_of_way.claimed[movement] |= (
                state == _TAKEN and waited > traffic.lane_links.arrival_penalty[movement] + CLAIM_AFTER
            )
            if vehicle != ego and state == _TAKEN and waited > LONG_DETOUR_AFTER:
                _take_detour(traffic, vehicle, movement)
            continue
        exit_link = exit_of(traffic, movement)
        yielding = still_penalized and traffic.movements.yields[movement]
        if not _has_room(
            traffic, exit_link, (right_of_way.inbound[exit_link] + (2 if yielding else 1)) * SLOT
        ):
            # The ring of a roundabout must not take every gap.
            right_of_way.claimed[movement] |= traffic.movements.yields[movement] and not still_penalized
            if vehicle != ego and waited > DETOUR_AFTER:
                _take_detour(traffic, vehicle, movement)
            continue
        right_of_way.granted[vehicle] = movement
        right_of_way.granted_at[vehicle] = scratch.clock[0]
        scratch.grants[0] += 1
        right_of_way.grant_number[vehicle] = scratch.grants[0]
        right_of_way.waiting_since[vehicle] = math.inf
        right_of_way.holders[movement] += 1
        right_of_way.rearmost[movement] = -math.inf
        right_of_way.inbound[exit_link] += 1


@part
def _sort_requests(traffic: Traffic) -> int:
    """Sort the requests by time, arrival penalty included; return how many there are."""
    order, waiting_since = traffic.scratch.order, traffic.right_of_way.waiting_since
    ahead, penalty = traffic.right_of_way.ahead, traffic.lane_links.arrival_penalty
    count = 0
    for vehicle in range(waiting_since.shape[0]):
        if waiting_since[vehicle] == math.inf:
            continue
        since = waiting_since[vehicle] + penalty[ahead[vehicle]]
        place = count
        while place > 0:
            other = order[place - 1]
            if waiting_since[other] + penalty[ahead[other]] <= since:
                break
            order[place] = other
            place -= 1
        order[place] = vehicle
        count += 1
    return count


@part
def _availability(traffic: Traffic, vehicle: int, movement: int) -> int:
    """Tell whether a movement is free: no vehicle is in the way, and none that has waited longer would be."""
    vehicles = traffic.background.lane.shape[0]
    for_ego = vehicle == vehicles
    movements, right_of_way, blocks = traffic.movements, traffic.right_of_way, traffic.ego_on_links.blocks
    if not for_ego and blocks[movement] > 0:
        return _TAKEN_BY_EGO
    by_ego = False
    for index in range(movements.conflict_start[movement], movements.conflict_start[movement + 1]):
        conflict = movements.conflict[index]
        if right_of_way.claimed[conflict]:
            return _TAKEN
        if right_of_way.holders[conflict] > 0 and not clears_in_time(traffic, vehicle, index, conflict):
            return _TAKEN
        by_ego |= not for_ego and blocks[conflict] == 2
    return _TAKEN_BY_EGO if by_ego else _FREE


@part
def _has_room(traffic: Traffic, link: int, needed: float) -> bool:
    """Tell whether `link` has `needed` metres of room, even if the vehicles on it brake hard."""
    scratch, lane_links, background = traffic.scratch, traffic.lane_links, traffic.background
    vehicles = background.lane.shape[0]
    while needed > 0.0:
        if traffic.ego_on_links.rear[link] < needed:
            return False
        entry = scratch.first[link]
        while entry != NONE:
            vehicle = vehicle_of(entry, vehicles)
            rear = scratch.position[entry] - 0.5 * background.length[vehicle]
            if rear >= needed:
                break
            speed = background.speed[vehicle]
            if rear + speed * speed / 12.0 < needed:
                return False
            entry = scratch.following[entry]
        start = lane_links.next_start[link]
        if (
            lane_links.next_start[link + 1] == start
            or lane_links.next[start] < lane_links.arrival_penalty.shape[0]
        ):
            return lane_links.room[link] >= needed
        needed -= lane_links.length[link]
        link = lane_links.next[start]
    return True


@part
def _take_detour(traffic: Traffic, vehicle: int, movement: int) -> None:
    """Give a waiting vehicle another movement from its lane, if one is free and has room on its exit."""
    movements, right_of_way = traffic.movements, traffic.right_of_way
    start, end = movements.sibling_start[movement], movements.sibling_start[movement + 1]
    if end == start or traffic.background.path[vehicle, 1] != movement:
        return
    first = random_below(traffic.background.random_state[vehicle : vehicle + 1], end - start)
    for index in range(end - start):
        other = movements.sibling[start + (first + index) % (end - start)]
        exit_link = exit_of(traffic, other)
        if _has_room(traffic, exit_link, (right_of_way.inbound[exit_link] + 1) * SLOT) and (
            _availability(traffic, vehicle, other) == _FREE
        ):
            traffic.background.path[vehicle, 1] = other
            plan_from(traffic.lane_links, traffic.background, vehicle, 2)
            return
