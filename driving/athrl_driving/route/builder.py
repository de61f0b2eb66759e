"""Builds a route lane by lane, by its plan or with random turns; a lane change is an S of two arcs."""

from __future__ import annotations

import math

from athrl_driving.kernels.compilation import inlined, inner
from athrl_driving.kernels.random_numbers import random_below
from athrl_driving.maps.arcs import pose_on_arc
from athrl_driving.maps.geometry import lane_pose
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.route.state import (
    CURVATURE,
    LENGTH,
    SEGMENTS,
    START_HEADING,
    START_POSITION,
    START_X,
    START_Y,
    TO_THE_EDGE,
    RouteState,
)

CHANGE_LENGTH = 30.0
"""Metres along the lanes that a lane change takes where there is room: at 8 m/s about 1 m/s2 sideways."""

KNOWN_AHEAD = 100.0
"""Metres of route ahead of the ego up to which it is built at a time."""

BEYOND_END = 100.0
"""Metres of straight line that follow a route's end, so that there are waypoints until the ego is there."""

_LEAST_CHANGE_LENGTH = 15.0
_TOO_SHORT = 4.0
_PAST_DESTINATION = 5.0

_SEGMENTS_OF_A_CHANGE = 34
"""Room for the segments of one lane change: a change over more lanes than this ends earlier."""

_NONE = -1


@inlined
def laid_position(route: RouteState) -> float:
    """Return how far the route has been built, m along it."""
    last = route.segment_count[0] - 1
    return route.segments[last, START_POSITION] + route.segments[last, LENGTH]


@inlined
def append_segment(
    route: RouteState,
    x: float,
    y: float,
    heading: float,
    curvature: float,
    length: float,
    lane: int,
    s: float,
) -> None:
    """Append a segment to the route, unless it has no length."""
    if length < 1e-9:
        return
    last = route.segment_count[0]
    start = laid_position(route) if last > 0 else 0.0
    segment = route.segments[last]
    segment[START_X], segment[START_Y], segment[START_HEADING] = x, y, heading
    segment[CURVATURE], segment[LENGTH], segment[START_POSITION] = curvature, length, start
    route.lane[last], route.lane_start[last] = lane, s
    route.segment_count[0] = last + 1


@inner
def extend(graph: LaneGraph, route: RouteState) -> None:
    """Append segments until enough of the route ahead is known (or the room for segments is used up)."""
    while (
        route.end[0] == math.inf
        and laid_position(route) < route.position[0] + KNOWN_AHEAD
        and route.segment_count[0] + _SEGMENTS_OF_A_CHANGE + 2 < SEGMENTS
    ):
        lane, s = route.laid_lane[0], route.laid_s[0]
        if _is_on_last_planned(route):
            _append_past_destination(graph, route)
            continue
        beside = _next_change(graph, route)
        if beside >= 0:
            room = _room_for_change(graph, route, beside, s * graph.length[beside] / graph.length[lane])
            if room > _TOO_SHORT:
                _append_change(graph, route, lane, beside, s, room)
                continue
        x, y, heading = lane_pose(graph, lane, s)
        append_segment(route, x, y, heading, graph.curvature[lane], graph.length[lane] - s, lane, s)
        following = _next_lane(graph, route, lane)
        if following == _NONE:
            _end_route(graph, route)
            return
        _continue_on(route, following, 0.0)


@inlined
def _end_route(graph: LaneGraph, route: RouteState) -> None:
    """Let the route end where it is built to, at the end of a lane that no other follows."""
    lane = route.laid_lane[0]
    route.laid_s[0] = graph.length[lane]
    route.end[0] = laid_position(route)
    x, y, heading = lane_pose(graph, lane, graph.length[lane])
    append_segment(route, x, y, heading, 0.0, BEYOND_END, lane, graph.length[lane])


@inlined
def _is_on_last_planned(route: RouteState) -> bool:
    """Tell whether the route ends on the plan's last lane."""
    return route.plan_count[0] > 0 and route.plan_next[0] == route.plan_count[0] - 1


@inlined
def _append_past_destination(graph: LaneGraph, route: RouteState) -> None:
    """Append the plan's last lane to a little beyond the destination; from there on turns are drawn."""
    lane, s = route.laid_lane[0], route.laid_s[0]
    end = min(max(route.destination_s[0], s) + _PAST_DESTINATION, graph.length[lane])
    x, y, heading = lane_pose(graph, lane, s)
    append_segment(route, x, y, heading, graph.curvature[lane], end - s, lane, s)
    route.laid_s[0] = end
    route.plan_count[0] = 0


@inlined
def _continue_on(route: RouteState, lane: int, s: float) -> None:
    """Let the route end `s` metres along a lane, and advance to that lane in the plan."""
    route.laid_lane[0], route.laid_s[0] = lane, s
    if route.plan_next[0] + 1 < route.plan_count[0]:
        route.plan_next[0] += 1
    else:
        route.plan_count[0] = 0
    note_arrival(route)


@inlined
def note_arrival(route: RouteState) -> None:
    """Set the destination's position along the route once the last lane of the plan is reached."""
    if _is_on_last_planned(route):
        end = laid_position(route) if route.segment_count[0] > 0 else 0.0
        route.arrival[0] = end + max(route.destination_s[0] - route.laid_s[0], 0.0)


@inlined
def _is_successor(graph: LaneGraph, lane: int, other: int) -> bool:
    """Tell whether a lane leads to another."""
    for index in range(graph.successor_start[lane], graph.successor_start[lane + 1]):
        if graph.successor[index] == other:
            return True
    return False


@inlined
def _planned(route: RouteState, steps: int) -> int:
    """Return the planned lane `steps` after the one on which the route ends, or -1."""
    place = route.plan_next[0] + steps
    return route.plan[place] if place < route.plan_count[0] else _NONE


@inlined
def _next_change(graph: LaneGraph, route: RouteState) -> int:
    """Return the lane beside the present one to change to before its end, or -1.

    The plan decides; without one only lanes that end are left, for the neighbour that leads on farthest.
    """
    lane = route.laid_lane[0]
    left, right = graph.left[lane], graph.right[lane]
    planned = _planned(route, 1)
    if planned != _NONE:
        beside = planned in (left, right)
        return planned if beside and not _is_successor(graph, lane, planned) else _NONE
    best, farthest = _NONE, route.lanes_reach[lane]
    if farthest == math.inf:
        return _NONE
    if left >= 0 and route.lanes_reach[left] > farthest:
        best, farthest = left, route.lanes_reach[left]
    if right >= 0 and route.lanes_reach[right] > farthest:
        best = right
    return best


@inlined
def _next_lane(graph: LaneGraph, route: RouteState, lane: int) -> int:
    """Return the lane to continue on: the planned one, else one drawn among the best, or -1.

    Lanes that go on for ever are best, those that lead off the map come before dead ends.
    """
    planned = _planned(route, 1)
    if planned != _NONE:
        if _is_successor(graph, lane, planned):
            return planned
        # The plan was made for another map or leaves the lanes: from here on turns are drawn.
        route.plan_count[0] = 0
    first, last = graph.successor_start[lane], graph.successor_start[lane + 1]
    farthest = TO_THE_EDGE
    for index in range(first, last):
        farthest = max(farthest, route.lanes_reach[graph.successor[index]])
    continuing = 0
    for index in range(first, last):
        continuing += route.lanes_reach[graph.successor[index]] == farthest
    if continuing == 0:
        return (
            graph.successor[first + random_below(route.random_state, last - first)] if last > first else _NONE
        )
    drawn = random_below(route.random_state, continuing) if continuing > 1 else 0
    for index in range(first, last):
        if route.lanes_reach[graph.successor[index]] == farthest:
            if drawn == 0:
                return graph.successor[index]
            drawn -= 1
    return _NONE


@inlined
def _next_in_change(graph: LaneGraph, route: RouteState, lane: int, steps: int) -> int:
    """Return the lane on which a lane change may continue after `lane`, -1 at a junction or a fork."""
    first = graph.successor_start[lane]
    if graph.successor_start[lane + 1] != first + 1:
        return _NONE
    following = graph.successor[first]
    if graph.movement[following] >= 0:
        return _NONE
    planned = _planned(route, steps)
    return following if planned in (_NONE, following) else _NONE


@inlined
def _room_for_change(graph: LaneGraph, route: RouteState, beside: int, s: float) -> float:
    """Return the metres that a change to lane `beside` may take from `s` metres along it."""
    room, lane = graph.length[beside] - s, beside
    for step in range(2, _SEGMENTS_OF_A_CHANGE):
        if room >= CHANGE_LENGTH:
            break
        following = _next_in_change(graph, route, lane, step)
        if following == _NONE:
            break
        room, lane = room + graph.length[following], following
    further = _planned(route, 2)
    if further != _NONE and further in (graph.left[beside], graph.right[beside]):
        # The next change has to be made on this lane too.
        room = 0.5 * (graph.length[beside] - s)
    elif further == _NONE and route.plan_count[0] > 0:
        # The destination is on this lane.
        room = min(room, max(graph.length[beside] - s, _LEAST_CHANGE_LENGTH))
    return min(room, CHANGE_LENGTH)


@inlined
def _append_change(
    graph: LaneGraph, route: RouteState, lane: int, beside: int, s: float, room: float
) -> None:
    """Append an S from `s` metres along a lane to `room` metres further on the lanes beside it."""
    target, target_s = beside, s * graph.length[beside] / graph.length[lane]
    x, y, heading = lane_pose(graph, lane, s)
    _continue_on(route, target, target_s)
    # Where on the target's lanes the S ends, and its two arcs from there.
    end, end_s = target, target_s + room
    steps = 0
    while end_s > graph.length[end] + 1e-9:
        end_s -= graph.length[end]
        end = graph.successor[graph.successor_start[end]]
        steps += 1
    end_s = min(end_s, graph.length[end])
    end_x, end_y, end_heading = lane_pose(graph, end, end_s)
    first_curvature, first_length, second_curvature, second_length = _two_arcs(
        x, y, heading, end_x, end_y, end_heading
    )
    total = first_length + second_length
    along, driven, curvature = 0.0, 0.0, first_curvature
    for _ in range(2 * steps + 4):
        rest = graph.length[target] - target_s if target != end else end_s - target_s
        until = total if target == end else min(total, (driven + rest) / room * total)
        if along < first_length:
            until = min(until, first_length)
        length = until - along
        append_segment(route, x, y, heading, curvature, length, target, target_s)
        if length > 0.0:
            x, y, heading = pose_on_arc(x, y, heading, curvature, length)
        along_lane = length / total * room
        along, driven, target_s = until, driven + along_lane, target_s + along_lane
        if along >= first_length:
            curvature = second_curvature
        if along >= total:
            break
        if target != end and target_s >= graph.length[target] - 1e-9:
            target, target_s = graph.successor[graph.successor_start[target]], 0.0
            _continue_on(route, target, 0.0)
    while target != end:
        target = graph.successor[graph.successor_start[target]]
        _continue_on(route, target, 0.0)
    route.laid_s[0] = end_s
    note_arrival(route)


@inlined
def _arc_to(x: float, y: float, heading: float, to_x: float, to_y: float) -> tuple[float, float]:
    """Return (curvature, length) of the arc from a pose to a point."""
    dx, dy = to_x - x, to_y - y
    chord = math.hypot(dx, dy)
    cosine, sine = math.cos(heading), math.sin(heading)
    angle = math.atan2(dy * cosine - dx * sine, dx * cosine + dy * sine)
    if chord < 1e-12 or abs(angle) < 1e-12:
        return 0.0, chord
    return 2.0 * math.sin(angle) / chord, chord * angle / math.sin(angle)


@inlined
def _two_arcs(
    x: float, y: float, heading: float, to_x: float, to_y: float, to_heading: float
) -> tuple[float, float, float, float]:
    """Return curvature and length of the two arcs that lead smoothly from one pose to another (a biarc)."""
    cos0, sin0 = math.cos(heading), math.sin(heading)
    cos1, sin1 = math.cos(to_heading), math.sin(to_heading)
    dx, dy = to_x - x, to_y - y
    across = dx * (cos0 + cos1) + dy * (sin0 + sin1)
    apart = dx * dx + dy * dy
    bend = 1.0 - (cos0 * cos1 + sin0 * sin1)
    # Both tangents are equally long; this form of the root is exact for parallel headings too.
    tangent = apart / (across + math.sqrt(across * across + 2.0 * bend * apart))
    joint_x = 0.5 * (x + to_x + tangent * (cos0 - cos1))
    joint_y = 0.5 * (y + to_y + tangent * (sin0 - sin1))
    first_curvature, first_length = _arc_to(x, y, heading, joint_x, joint_y)
    joint_heading = heading + first_curvature * first_length
    second_curvature, second_length = _arc_to(joint_x, joint_y, joint_heading, to_x, to_y)
    return first_curvature, first_length, second_curvature, second_length
