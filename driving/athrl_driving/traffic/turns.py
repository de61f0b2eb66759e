"""In which order vehicles pass where their ways through a junction meet, compiled.

Every right to cross has a turn, a number, and comes after those granted before. Its holder drives up to where
its way meets somebody with an earlier turn; nobody waits for a later turn, so nobody waits in a circle.
"""

import math

from athrl_driving.compilation import part
from athrl_driving.traffic.columns import NOBODY, Traffic

SLOWEST_GOING = 2.0
"""m/s from which on a vehicle in a junction counts as leaving it."""

STARTING_ACCELERATION = 2.0
"""m/s2 with which a vehicle is taken to come to where others are about to leave."""

_BEYOND_HELP = 1.0


@part
def exit_of(traffic: Traffic, movement: int) -> int:
    """Return the link that a movement leads to."""
    return traffic.rails.next[traffic.rails.next_start[movement]]


@part
def is_gone_in_time(traffic: Traffic, row: int, index: int, conflict: int) -> bool:
    """Tell whether all who hold a conflict are out of the way when vehicle `row`, which asks, comes.

    `index` is where the pair stands among all conflicts.
    """
    right_of_way, meetings = traffic.right_of_way, traffic.meetings
    rest = meetings.clear[index] - right_of_way.rearmost[conflict]
    if rest <= 0.0:
        return True
    speed = right_of_way.rearmost_speed[conflict]
    if rest == math.inf or speed < SLOWEST_GOING or row == traffic.background.lane.shape[0]:
        return False
    return rest / speed <= _time_over(traffic, row, right_of_way.line_distance[row] + meetings.begin[index])


@part
def _time_over(traffic: Traffic, row: int, way: float) -> float:
    """Return how long a vehicle takes for `way` metres up to and along the movement that it asks for, s."""
    pace = traffic.rails.crossing_pace[traffic.right_of_way.ahead[row]]
    slower = max(pace - traffic.background.speed[row], 0.0)
    return way / pace + slower * slower / (2.0 * STARTING_ACCELERATION * pace)


@part
def _overhang(traffic: Traffic, movement: int) -> float:
    """Return how far along a movement the rear is of who has just left it; infinite where there is nobody."""
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    node = scratch.first[exit_of(traffic, movement)]
    if node == NOBODY or node >= traffic.background.lane.shape[0] or right_of_way.crossing[node] != movement:
        return math.inf
    return scratch.position[node] - 0.5 * traffic.background.length[node] + traffic.rails.length[movement]


@part
def way_to_a_meeting(traffic: Traffic, row: int, movement: int, base: float, turn: int) -> float:
    """Return how far vehicle `row` may drive (m) before it is in the way of who has an earlier turn.

    `base` is the way to the start of its movement, from its centre.
    """
    movements, meetings, scratch = traffic.movements, traffic.meetings, traffic.scratch
    right_of_way, lengths = traffic.right_of_way, traffic.background.length
    way = math.inf
    for index in range(movements.conflict_start[movement], movements.conflict_start[movement + 1]):
        conflict = movements.conflict[index]
        if right_of_way.holders[conflict] == 0:
            continue
        to_meeting = base + meetings.begin[index] - 0.5 * lengths[row]
        if to_meeting < -_BEYOND_HELP or to_meeting > way:
            continue
        waits = False
        node = scratch.first[conflict]
        while node != NOBODY and not waits:
            if scratch.position[node] - 0.5 * lengths[node] >= meetings.clear[index]:
                break
            waits = right_of_way.crossing_turn[node] < turn
            node = scratch.following[node]
        if not waits and _overhang(traffic, conflict) < meetings.clear[index]:
            waits = right_of_way.crossing_turn[scratch.first[exit_of(traffic, conflict)]] < turn
        if waits:
            way = to_meeting
    return way
