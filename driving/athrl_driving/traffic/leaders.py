"""Who drives ahead on a vehicle's path, and the next junction on it."""

import math

from athrl_driving.compilation import inlined
from athrl_driving.maps.lane_graph import Integers, LaneGraph, Movements
from athrl_driving.traffic.state import NOBODY, Background, EgoOnLanes, RightOfWay, Scratch

LOOK_AHEAD = 60.0
"""Metres of its path that a vehicle looks at."""

_LONGEST_VEHICLE = 12.0


@inlined
def sort_by_lane(background: Background, scratch: Scratch) -> None:
    """List the vehicles of every lane."""
    lanes, first, following = background.lane, scratch.first_on_lane, scratch.next_on_lane
    first[:] = NOBODY
    for vehicle in range(lanes.shape[0]):
        lane = lanes[vehicle]
        following[vehicle] = first[lane]
        first[lane] = vehicle


@inlined
def look_ahead(
    graph: LaneGraph,
    movements: Movements,
    background: Background,
    right_of_way: RightOfWay,
    covered: EgoOnLanes,
    scratch: Scratch,
    row: int,
    path: Integers,
    place: int,
    s: float,
    length: float,
    sees_ego: bool,
) -> None:
    """Find the leader and the next movement of vehicle `row` (N: the ego) and note them.

    It is at `s` metres on lane `path[place]` and `length` metres long. The leader is the nearest of: the
    vehicles on the lanes of the path, those on ways that part from the path and have not left it with their
    rear, and the ego where it covers a lane of the path.
    """
    lane_movement, lane_length, offset = graph.movement, graph.length, graph.movement_offset
    along, first, following = background.s, scratch.first_on_lane, scratch.next_on_lane
    gap, leader_speed, leader, leader_middle = math.inf, 0.0, NOBODY, math.inf
    ahead, line = NOBODY, math.inf
    base = -s
    present = lane_movement[path[place]]
    for index in range(place, path.shape[0]):
        lane = path[index]
        if lane < 0:
            break
        movement = lane_movement[lane]
        if movement >= 0 and movement != present and ahead == NOBODY:
            ahead, line = movement, base - 0.5 * length
        if leader == NOBODY:
            other = first[lane]
            while other != NOBODY:
                middle = base + along[other]
                if 0.0 < middle < leader_middle and other != row:
                    leader, leader_middle = other, middle
                other = following[other]
            if movement >= 0 and (index == place or offset[lane] == 0.0):
                start = base - offset[lane]
                other = _parting(graph, movements, background, scratch, movement, start, leader_middle)
                if other != NOBODY:
                    leader, leader_middle = other, start + offset[background.lane[other]] + along[other]
            if leader != NOBODY:
                gap = leader_middle - 0.5 * (length + background.length[leader])
                leader_speed = background.speed[leader]
            if sees_ego and covered.rear[lane] < math.inf:
                middle = base + 0.5 * (covered.rear[lane] + covered.front[lane])
                ego_gap = base + covered.rear[lane] - 0.5 * length
                if middle > 0.0 and ego_gap < gap:
                    gap, leader_middle, leader_speed = ego_gap, middle, covered.speed[lane]
                    leader = along.shape[0]
        base += lane_length[lane]
        if base > LOOK_AHEAD or (leader != NOBODY and ahead != NOBODY):
            break
    scratch.gap[row], scratch.leader_speed[row] = gap, leader_speed
    right_of_way.ahead[row], right_of_way.line_distance[row] = ahead, line
    # Who drives behind somebody without a right to cross waits its turn.
    before_line = leader != NOBODY and leader_middle < line + 0.5 * length
    scratch.held_up[row] = before_line and right_of_way.granted[leader] == NOBODY


@inlined
def _parting(
    graph: LaneGraph,
    movements: Movements,
    background: Background,
    scratch: Scratch,
    movement: int,
    base: float,
    nearer_than: float,
) -> int:
    """Return the nearest vehicle ahead on a way from the same origin that still covers some of `movement`.

    `base` is the distance (m) to where the ways start.
    """
    found = NOBODY
    for index in range(movements.sibling_start[movement], movements.sibling_start[movement + 1]):
        sibling, shared = movements.sibling[index], movements.shared[index]
        for place in range(movements.lane_start[sibling], movements.lane_start[sibling + 1]):
            lane = movements.lane[place]
            if graph.movement_offset[lane] > shared + 0.5 * _LONGEST_VEHICLE:
                break
            other = scratch.first_on_lane[lane]
            while other != NOBODY:
                driven = graph.movement_offset[lane] + background.s[other]
                middle = base + driven
                if driven - 0.5 * background.length[other] < shared and 0.0 < middle < nearer_than:
                    found, nearer_than = other, middle
                other = scratch.next_on_lane[other]
    return found
