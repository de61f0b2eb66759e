"""Who crosses a junction when: reservations, first come first served with bounded courtesy, compiled.

A vehicle asks for its movement in time to cross without braking and gets it when its light is green or there
is none, when nobody holds a movement that gets in its way, when the ego is not in its way, and when there is
room for it behind the junction; so nobody stands in a junction and blocks it. Who has waited longest is
served first, and nobody overtakes it in time who would get in its way. Movements that give way count as
having come later (`Rails.later`) and, while they do, need room for two behind the junction, so that a
roundabout does not fill up. The ego asks like everybody else; where it drives without asking, what it covers
is taken.
"""

import math

from athrl_driving.compilation import part
from athrl_driving.traffic.columns import NOBODY, Traffic
from athrl_driving.traffic.nodes import owner
from athrl_driving.traffic.paths import plan_from, random_below
from athrl_driving.traffic.rails import CURVE_BRAKING
from athrl_driving.traffic.signals import GREEN, light
from athrl_driving.traffic.turns import exit_of, is_gone_in_time

SLOT = 10.0
"""Metres of road that a standing vehicle needs behind a junction: its length and the gap to the next."""

DETOUR_AFTER = 8.0
"""Seconds without room on the exit after which a vehicle takes another way that has room."""

LONG_DETOUR_AFTER = 20.0
"""Seconds of waiting for others after which a vehicle takes another way that is free."""

GIVE_BACK_AFTER = 6.0
"""Seconds that a vehicle may stand before the line with a right to cross before it has to ask again."""

ASK_MARGIN = 15.0
"""Metres before the point where it would have to brake for the line at which a vehicle asks."""

CLAIM_AFTER = 25.0
"""Seconds of waiting, beyond what a movement gives way, after which nobody new may get in its way."""

_FREE, _TAKEN, _EGO = 0, 1, 2


@part
def count_holders(traffic: Traffic) -> None:
    """Count who holds each movement, how far they are, and who is on the way to each exit."""
    right_of_way, rails, scratch = traffic.right_of_way, traffic.rails, traffic.scratch
    rearmost, holders, inbound = right_of_way.rearmost, right_of_way.holders, right_of_way.inbound
    granted, crossing = right_of_way.granted, right_of_way.crossing
    holders[:] = 0
    inbound[:] = 0
    rearmost[:] = math.inf
    right_of_way.claimed[:] = False
    vehicles = traffic.background.lane.shape[0]
    for row in range(vehicles + 1):
        movement = granted[row]
        if movement >= 0:
            holders[movement] += 1
            inbound[exit_of(traffic, movement)] += 1
            rearmost[movement] = -math.inf
        movement = crossing[row]
        if movement >= 0:
            holders[movement] += 1
            if row == vehicles:
                # The ego may turn back or stop anywhere: it holds the whole movement until it has left.
                inbound[exit_of(traffic, movement)] += 1
                rearmost[movement] = -math.inf
                continue
            rear = scratch.position[row] - 0.5 * traffic.background.length[row]
            if scratch.link[row] == movement:
                inbound[exit_of(traffic, movement)] += 1
            else:
                rear += rails.length[movement]
            if rear < rearmost[movement]:
                rearmost[movement] = rear
                right_of_way.rearmost_speed[movement] = traffic.background.speed[row]


@part
def ask(traffic: Traffic, row: int, speed: float) -> None:
    """Let a vehicle that has looked ahead ask for its next movement, keep it, or give it back."""
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    ahead, granted = right_of_way.ahead[row], right_of_way.granted[row]
    if ahead == NOBODY and granted == NOBODY:
        right_of_way.waiting_since[row] = math.inf
        return
    now, line = scratch.clock[0], right_of_way.line_distance[row]
    braking = speed * speed / (2.0 * CURVE_BRAKING)
    green = ahead != NOBODY and light(traffic, ahead) == GREEN
    if granted != NOBODY:
        idle = speed < 0.1 and line > 0.0 and now - right_of_way.granted_at[row] > GIVE_BACK_AFTER
        stops = not green and line > braking + 1.0
        if idle or stops or granted != ahead:
            granted = NOBODY
            right_of_way.granted[row] = NOBODY
    asks = ahead != NOBODY and granted == NOBODY and green and not scratch.held_up[row]
    if not asks or line > braking + ASK_MARGIN:
        right_of_way.waiting_since[row] = math.inf
    elif right_of_way.waiting_since[row] == math.inf:
        right_of_way.waiting_since[row] = now


@part
def serve(traffic: Traffic) -> None:
    """Grant what can be granted, in order of waiting."""
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    ego_row = traffic.background.lane.shape[0]
    for index in range(_queue(traffic)):
        row = scratch.order[index]
        movement = right_of_way.ahead[row]
        waited = scratch.clock[0] - right_of_way.waiting_since[row]
        second = waited < traffic.rails.later[movement]
        state = _state_of(traffic, row, movement)
        if state != _FREE:
            # Who waits for the ego, which may stand for ever, keeps nobody else from crossing.
            right_of_way.claimed[movement] |= (
                state == _TAKEN and waited > traffic.rails.later[movement] + CLAIM_AFTER
            )
            if row != ego_row and state == _TAKEN and waited > LONG_DETOUR_AFTER:
                _take_another_way(traffic, row, movement)
            continue
        exit_link = exit_of(traffic, movement)
        gives_way = second and traffic.movements.yields[movement]
        if not _has_room(
            traffic, exit_link, (right_of_way.inbound[exit_link] + (2 if gives_way else 1)) * SLOT
        ):
            # The ring does not take every gap for ever.
            right_of_way.claimed[movement] |= traffic.movements.yields[movement] and not second
            if row != ego_row and waited > DETOUR_AFTER:
                _take_another_way(traffic, row, movement)
            continue
        right_of_way.granted[row] = movement
        right_of_way.granted_at[row] = scratch.clock[0]
        scratch.turns[0] += 1
        right_of_way.turn[row] = scratch.turns[0]
        right_of_way.waiting_since[row] = math.inf
        right_of_way.holders[movement] += 1
        right_of_way.rearmost[movement] = -math.inf
        right_of_way.inbound[exit_link] += 1


@part
def _queue(traffic: Traffic) -> int:
    """Sort who asks by when it came, or counts as having come; return how many there are."""
    order, waiting_since = traffic.scratch.order, traffic.right_of_way.waiting_since
    ahead, later = traffic.right_of_way.ahead, traffic.rails.later
    count = 0
    for row in range(waiting_since.shape[0]):
        if waiting_since[row] == math.inf:
            continue
        since = waiting_since[row] + later[ahead[row]]
        place = count
        while place > 0:
            other = order[place - 1]
            if waiting_since[other] + later[ahead[other]] <= since:
                break
            order[place] = other
            place -= 1
        order[place] = row
        count += 1
    return count


@part
def _state_of(traffic: Traffic, row: int, movement: int) -> int:
    """Tell whether nobody is in the way of a movement, and nobody who has waited longer would be."""
    vehicles = traffic.background.lane.shape[0]
    for_ego = row == vehicles
    movements, right_of_way, blocks = traffic.movements, traffic.right_of_way, traffic.ego_on_links.blocks
    if not for_ego and blocks[movement] > 0:
        return _EGO
    by_ego = False
    for index in range(movements.conflict_start[movement], movements.conflict_start[movement + 1]):
        conflict = movements.conflict[index]
        if right_of_way.claimed[conflict]:
            return _TAKEN
        if right_of_way.holders[conflict] > 0 and not is_gone_in_time(traffic, row, index, conflict):
            return _TAKEN
        by_ego |= not for_ego and blocks[conflict] == 2
    return _EGO if by_ego else _FREE


@part
def _has_room(traffic: Traffic, link: int, needed: float) -> bool:
    """Tell whether `link` has `needed` metres of room, even if those on it brake hard."""
    scratch, rails, background = traffic.scratch, traffic.rails, traffic.background
    vehicles = background.lane.shape[0]
    while needed > 0.0:
        if traffic.ego_on_links.rear[link] < needed:
            return False
        node = scratch.first[link]
        while node != NOBODY:
            vehicle = owner(node, vehicles)
            rear = scratch.position[node] - 0.5 * background.length[vehicle]
            if rear >= needed:
                break
            speed = background.speed[vehicle]
            if rear + speed * speed / 12.0 < needed:
                return False
            node = scratch.following[node]
        start = rails.next_start[link]
        if rails.next_start[link + 1] == start or rails.next[start] < rails.later.shape[0]:
            return rails.room[link] >= needed
        needed -= rails.length[link]
        link = rails.next[start]
    return True


@part
def _take_another_way(traffic: Traffic, row: int, movement: int) -> None:
    """Let a vehicle go another way from the junction that it waits at, if one has room on its exit."""
    movements, right_of_way = traffic.movements, traffic.right_of_way
    start, end = movements.sibling_start[movement], movements.sibling_start[movement + 1]
    if end == start or traffic.background.path[row, 1] != movement:
        return
    first = random_below(traffic.background, row, end - start)
    for index in range(end - start):
        other = movements.sibling[start + (first + index) % (end - start)]
        exit_link = exit_of(traffic, other)
        if _has_room(traffic, exit_link, (right_of_way.inbound[exit_link] + 1) * SLOT) and (
            _state_of(traffic, row, other) == _FREE
        ):
            traffic.background.path[row, 1] = other
            plan_from(traffic.rails, traffic.background, row, 2)
            return
