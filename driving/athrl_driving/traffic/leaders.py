"""Who drives ahead on a vehicle's path, and the next junction on it, compiled."""

import math

from numba import njit

from athrl_driving.maps.lane_graph import Integers
from athrl_driving.traffic.state import NOBODY, Traffic

LOOK_AHEAD = 60.0
"""Metres of its path that a vehicle looks at."""


@njit(cache=True, nogil=True)
def sort_by_lane(traffic: Traffic) -> None:
    """List the vehicles of every lane."""
    background, scratch = traffic.background, traffic.scratch
    scratch.first_on_lane[:] = NOBODY
    for vehicle in range(background.lane.shape[0]):
        lane = background.lane[vehicle]
        scratch.next_on_lane[vehicle] = scratch.first_on_lane[lane]
        scratch.first_on_lane[lane] = vehicle


@njit(cache=True, nogil=True)
def look_ahead(
    traffic: Traffic, row: int, path: Integers, place: int, s: float, length: float, sees_ego: bool
) -> None:
    """Find the leader and the next movement of vehicle `row` (N: the ego) and note them.

    It is at `s` metres on lane `path[place]`, `length` metres long. The leader is the nearest of: the
    vehicles on the lanes of the path, those on ways that part from the path and have not left it with their
    rear, and the ego where it covers a lane of the path.
    """
    graph, background, covered = traffic.graph, traffic.background, traffic.ego_on_lanes
    scratch, right_of_way = traffic.scratch, traffic.right_of_way
    gap, leader_speed, leader, leader_middle = math.inf, 0.0, NOBODY, math.inf
    ahead, line = NOBODY, math.inf
    ego_row = background.lane.shape[0]
    base = -s
    present = graph.movement[path[place]]
    for index in range(place, path.shape[0]):
        lane = path[index]
        movement = graph.movement[lane]
        if movement >= 0 and movement != present and ahead == NOBODY:
            ahead, line = movement, base - 0.5 * length
        if leader == NOBODY:
            other = scratch.first_on_lane[lane]
            while other != NOBODY:
                middle = base + background.s[other]
                if middle > 0.0 and other != row and middle < leader_middle:
                    leader, leader_middle = other, middle
                other = scratch.next_on_lane[other]
            if movement >= 0 and (index == place or graph.movement_offset[lane] == 0.0):
                other = _parting(traffic, movement, base - graph.movement_offset[lane], leader_middle)
                if other != NOBODY:
                    leader = other
                    leader_lane = background.lane[other]
                    leader_middle = (
                        base
                        - graph.movement_offset[lane]
                        + graph.movement_offset[leader_lane]
                        + background.s[other]
                    )
            if leader != NOBODY:
                gap = leader_middle - 0.5 * (length + background.length[leader])
                leader_speed = background.speed[leader]
            if sees_ego and covered.rear[lane] < math.inf:
                middle = base + 0.5 * (covered.rear[lane] + covered.front[lane])
                ego_gap = base + covered.rear[lane] - 0.5 * length
                if middle > 0.0 and ego_gap < gap:
                    gap, leader, leader_middle, leader_speed = ego_gap, ego_row, middle, covered.speed[lane]
        base += graph.length[lane]
        if base > LOOK_AHEAD or (leader != NOBODY and ahead != NOBODY):
            break
    scratch.gap[row], scratch.leader_speed[row] = gap, leader_speed
    right_of_way.ahead[row], right_of_way.line_distance[row] = ahead, line
    # Who drives behind somebody without a right to cross waits its turn.
    before_line = leader != NOBODY and leader_middle < line + 0.5 * length
    scratch.held_up[row] = before_line and right_of_way.granted[leader] == NOBODY


@njit(cache=True, nogil=True)
def _parting(traffic: Traffic, movement: int, base: float, nearer_than: float) -> int:
    """Return the nearest vehicle ahead on a way from the same origin that still covers some of `movement`."""
    graph, movements, background = traffic.graph, traffic.movements, traffic.background
    found = NOBODY
    for index in range(movements.sibling_start[movement], movements.sibling_start[movement + 1]):
        sibling, shared = movements.sibling[index], movements.shared[index]
        for place in range(movements.lane_start[sibling], movements.lane_start[sibling + 1]):
            lane = movements.lane[place]
            if graph.movement_offset[lane] > shared + 6.0:
                break
            other = traffic.scratch.first_on_lane[lane]
            while other != NOBODY:
                driven = graph.movement_offset[lane] + background.s[other]
                middle = base + driven
                if driven - 0.5 * background.length[other] < shared and 0.0 < middle < nearer_than:
                    found, nearer_than = other, middle
                other = traffic.scratch.next_on_lane[other]
    return found
