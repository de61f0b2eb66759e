"""The order in which vehicles pass conflict zones, compiled.

Every grant has a number, in the order of granting. Its holder drives up to the conflict zone with a vehicle
of a smaller number, and waits there. No vehicle waits for one of a greater number, so there is no deadlock.
"""

import math

from athrl_driving.kernels.compilation import part
from athrl_driving.traffic.columns import NONE, Traffic

LEAST_CLEARING_SPEED = 2.0
"""m/s above which a vehicle in a junction counts as leaving it."""

STARTING_ACCELERATION = 2.0
"""m/s2 with which a vehicle is assumed to approach a zone that others are about to leave."""

_INSIDE_ZONE = 1.0
"""Metres beyond a zone's start from which a vehicle counts as inside and no longer waits before it."""


@part
def exit_of(traffic: Traffic, movement: int) -> int:
    """Return the link that a movement leads to."""
    return traffic.lane_links.next[traffic.lane_links.next_start[movement]]


@part
def clears_in_time(traffic: Traffic, vehicle: int, index: int, conflict: int) -> bool:
    """Tell whether the holders of a conflict are out of the way when a requesting vehicle arrives.

    `index` is the place of the pair among all conflicts.
    """
    right_of_way, conflict_zones = traffic.right_of_way, traffic.conflict_zones
    rest = conflict_zones.clear[index] - right_of_way.rearmost[conflict]
    if rest <= 0.0:
        return True
    speed = right_of_way.rearmost_speed[conflict]
    if rest == math.inf or speed < LEAST_CLEARING_SPEED or vehicle == traffic.background.lane.shape[0]:
        return False
    return rest / speed <= _travel_time(
        traffic, vehicle, right_of_way.line_distance[vehicle] + conflict_zones.begin[index]
    )


@part
def _travel_time(traffic: Traffic, vehicle: int, distance: float) -> float:
    """Return the time (s) for `distance` metres up to and along the movement that a vehicle requests."""
    pace = traffic.lane_links.crossing_pace[traffic.right_of_way.ahead[vehicle]]
    slower = max(pace - traffic.background.speed[vehicle], 0.0)
    return distance / pace + slower * slower / (2.0 * STARTING_ACCELERATION * pace)


@part
def _overhang(traffic: Traffic, movement: int) -> float:
    """Return m along a movement to the rear of the vehicle that has just left it; infinite without one."""
    right_of_way, scratch = traffic.right_of_way, traffic.scratch
    entry = scratch.first[exit_of(traffic, movement)]
    if entry == NONE or entry >= traffic.background.lane.shape[0] or right_of_way.crossing[entry] != movement:
        return math.inf
    return (
        scratch.position[entry] - 0.5 * traffic.background.length[entry] + traffic.lane_links.length[movement]
    )


@part
def distance_to_conflict_zone(
    traffic: Traffic, vehicle: int, movement: int, base: float, number: int
) -> float:
    """Return how far a vehicle may drive (m) before it is in the way of one with a smaller grant number.

    `base` is the distance (m) from its centre to the start of its movement.
    """
    movements, conflict_zones, scratch = traffic.movements, traffic.conflict_zones, traffic.scratch
    right_of_way, lengths = traffic.right_of_way, traffic.background.length
    distance = math.inf
    for index in range(movements.conflict_start[movement], movements.conflict_start[movement + 1]):
        conflict = movements.conflict[index]
        if right_of_way.holders[conflict] == 0:
            continue
        to_zone = base + conflict_zones.begin[index] - 0.5 * lengths[vehicle]
        if to_zone < -_INSIDE_ZONE or to_zone > distance:
            continue
        waits = False
        entry = scratch.first[conflict]
        while entry != NONE and not waits:
            if scratch.position[entry] - 0.5 * lengths[entry] >= conflict_zones.clear[index]:
                break
            waits = right_of_way.crossing_number[entry] < number
            entry = scratch.following[entry]
        if not waits and _overhang(traffic, conflict) < conflict_zones.clear[index]:
            waits = right_of_way.crossing_number[scratch.first[exit_of(traffic, conflict)]] < number
        if waits:
            distance = to_zone
    return distance
