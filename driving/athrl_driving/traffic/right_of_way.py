"""Who crosses a junction when: reservations, first come first served, compiled.

A vehicle asks for its movement in time to cross without braking and gets it when nobody holds a movement
that gets in its way, when the ego is not in its way, and when there is room for it behind the junction; so
nobody stands in a junction and blocks it. Who has waited longest is served first, and nobody overtakes it
in time who would get in its way. Entries of a roundabout come after the ring and need room for two, so that
the ring does not fill up; after `PATIENCE` they are served like all others. The ego asks like everybody else;
where it drives without asking, what it covers is taken.
"""

import math

from athrl_driving.compilation import inlined
from athrl_driving.maps.lane_graph import LaneGraph, Movements
from athrl_driving.traffic.paths import plan_from
from athrl_driving.traffic.state import NOBODY, PATH_LENGTH, Background, EgoOnLanes, RightOfWay, Scratch

SLOT = 10.0
"""Metres of road that a standing vehicle needs behind a junction: its length and the gap to the next."""

PATIENCE = 8.0
"""Seconds after which an entry of a roundabout is served like everybody else."""

DETOUR_AFTER = 8.0
"""Seconds without room on the exit after which a vehicle draws another way."""

GIVE_BACK_AFTER = 6.0
"""Seconds that a vehicle may stand before the line with a right to cross before it has to ask again."""

ASK_MARGIN = 15.0
"""Metres before the point where it would have to brake for the line at which a vehicle asks."""

LINE_BRAKING = 2.0
"""m/s2 towards a stop line."""

_ROOM_LOOK_AHEAD = 45.0


@inlined
def count_holders(
    graph: LaneGraph, movements: Movements, background: Background, right_of_way: RightOfWay
) -> None:
    """Count who holds each movement, how far they are, and who is on the way to each exit."""
    rearmost, offset = right_of_way.rearmost, graph.movement_offset
    holders, inbound, exits = right_of_way.holders, right_of_way.inbound, movements.exit
    granted, crossing = right_of_way.granted, right_of_way.crossing
    holders[:] = 0
    inbound[:] = 0
    rearmost[:] = math.inf
    right_of_way.claimed[:] = False
    vehicles = background.lane.shape[0]
    for row in range(vehicles + 1):
        if granted[row] >= 0:
            holders[granted[row]] += 1
            inbound[exits[granted[row]]] += 1
            rearmost[granted[row]] = -math.inf
        movement = crossing[row]
        if movement >= 0:
            holders[movement] += 1
            if row == vehicles:
                # The ego may turn back or stop anywhere: it holds the whole movement until it has left.
                inbound[exits[movement]] += 1
                rearmost[movement] = -math.inf
                continue
            lane = background.lane[row]
            rear = background.s[row] - 0.5 * background.length[row]
            if graph.movement[lane] == movement:
                inbound[exits[movement]] += 1
                rear += offset[lane]
            else:
                rear += movements.length[movement]
            rearmost[movement] = min(rearmost[movement], rear)


@inlined
def ask(right_of_way: RightOfWay, scratch: Scratch, row: int, speed: float) -> None:
    """Let a vehicle that has looked ahead ask for its next movement, keep it, or give it back."""
    now = scratch.clock[0]
    ahead, line = right_of_way.ahead[row], right_of_way.line_distance[row]
    if right_of_way.granted[row] != NOBODY:
        idle = speed < 0.1 and line > 0.0 and now - right_of_way.granted_at[row] > GIVE_BACK_AFTER
        if idle or right_of_way.granted[row] != ahead:
            right_of_way.granted[row] = NOBODY
    asks = ahead != NOBODY and right_of_way.granted[row] == NOBODY and not scratch.held_up[row]
    if not asks or line > speed * speed / (2.0 * LINE_BRAKING) + ASK_MARGIN:
        right_of_way.waiting_since[row] = math.inf
    elif right_of_way.waiting_since[row] == math.inf:
        right_of_way.waiting_since[row] = now


@inlined
def serve(
    graph: LaneGraph,
    movements: Movements,
    background: Background,
    right_of_way: RightOfWay,
    covered: EgoOnLanes,
    scratch: Scratch,
) -> None:
    """Grant what can be granted, in order of waiting."""
    ego_row = background.lane.shape[0]
    for index in range(_queue(movements, right_of_way, scratch)):
        row = scratch.order[index]
        movement = right_of_way.ahead[row]
        second = _is_second(movements, right_of_way, scratch, row)
        if not _is_free(movements, right_of_way, covered, movement, row == ego_row):
            right_of_way.claimed[movement] |= not second
            continue
        needed = (right_of_way.inbound[movements.exit[movement]] + (2 if second else 1)) * SLOT
        if not _has_room(graph, background, covered, scratch, movements.exit[movement], needed):
            # The ring does not take every gap for ever.
            right_of_way.claimed[movement] |= movements.yields[movement] and not second
            if row != ego_row and scratch.clock[0] - right_of_way.waiting_since[row] > DETOUR_AFTER:
                _take_another_way(graph, background, row, movement)
            continue
        right_of_way.granted[row] = movement
        right_of_way.granted_at[row] = scratch.clock[0]
        right_of_way.waiting_since[row] = math.inf
        right_of_way.holders[movement] += 1
        right_of_way.rearmost[movement] = -math.inf
        right_of_way.inbound[movements.exit[movement]] += 1


@inlined
def _is_second(movements: Movements, right_of_way: RightOfWay, scratch: Scratch, row: int) -> bool:
    """Tell whether a vehicle at an entry still has to let the ring go first."""
    waited = scratch.clock[0] - right_of_way.waiting_since[row]
    return movements.yields[right_of_way.ahead[row]] and waited < PATIENCE


@inlined
def _queue(movements: Movements, right_of_way: RightOfWay, scratch: Scratch) -> int:
    """Sort who asks: entries last, then by waiting; return how many there are."""
    order, waiting_since = scratch.order, right_of_way.waiting_since
    count = 0
    for row in range(waiting_since.shape[0]):
        since = waiting_since[row]
        if since == math.inf:
            continue
        second = _is_second(movements, right_of_way, scratch, row)
        place = count
        while place > 0:
            other = order[place - 1]
            other_second = _is_second(movements, right_of_way, scratch, other)
            if other_second == second:
                if waiting_since[other] <= since:
                    break
            elif second:
                break
            order[place] = other
            place -= 1
        order[place] = row
        count += 1
    return count


@inlined
def _is_free(
    movements: Movements, right_of_way: RightOfWay, covered: EgoOnLanes, movement: int, for_ego: bool
) -> bool:
    """Tell whether nobody is in the way of a movement, and nobody who has waited longer would be."""
    blocks = covered.blocks
    if not for_ego and blocks[movement] > 0:
        return False
    for index in range(movements.conflict_start[movement], movements.conflict_start[movement + 1]):
        conflict = movements.conflict[index]
        if right_of_way.claimed[conflict]:
            return False
        if right_of_way.holders[conflict] > 0 and right_of_way.rearmost[conflict] < movements.release[index]:
            return False
        if not for_ego and blocks[conflict] == 2:
            return False
    return True


@inlined
def _has_room(
    graph: LaneGraph,
    background: Background,
    covered: EgoOnLanes,
    scratch: Scratch,
    lane: int,
    needed: float,
) -> bool:
    """Tell whether the exit `lane` has `needed` metres of room, even if those on it brake hard."""
    base = 0.0
    while base < _ROOM_LOOK_AHEAD:
        tail = covered.rear[lane]
        other = scratch.first_on_lane[lane]
        while other != NOBODY:
            speed = background.speed[other]
            tail = min(tail, background.s[other] - 0.5 * background.length[other] + speed * speed / 12.0)
            other = scratch.next_on_lane[other]
        if tail < math.inf:
            return base + tail >= needed
        base += graph.length[lane]
        lane = graph.successor[graph.successor_start[lane]]
        if graph.movement[lane] >= 0:
            return base >= needed
    return base >= needed


@inlined
def _take_another_way(graph: LaneGraph, background: Background, row: int, movement: int) -> None:
    """Let a background vehicle draw its path anew from the junction on that it cannot cross."""
    for place in range(1, PATH_LENGTH):
        if graph.movement[background.path[row, place]] == movement:
            plan_from(graph, background, row, place)
            return
