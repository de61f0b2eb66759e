"""How a route grows: row after row of its plan or with random turns, and lane changes as an S of two arcs."""

from __future__ import annotations

import math

from numba import uint64

from athrl_driving.compilation import inlined, inner
from athrl_driving.maps.geometry import lane_pose
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.route.state import (
    CURVATURE,
    LENGTH,
    PIECES,
    START_HEADING,
    START_POSITION,
    START_X,
    START_Y,
    RouteState,
)

CHANGE_LENGTH = 30.0
"""Metres along the lanes that a lane change takes where there is room: at 8 m/s about 1 m/s2 sideways."""

KNOWN_AHEAD = 100.0
"""Metres of route ahead of the ego that are laid at a time."""

_LEAST_CHANGE_LENGTH = 15.0
_TOO_SHORT = 4.0
_PAST_DESTINATION = 5.0

_PIECES_OF_A_CHANGE = 34
"""A change that takes more rows than this ends where they do."""

_INCREMENT = 0x9E3779B97F4A7C15
_NONE = -1


@inlined
def _draw_below(route: RouteState, bound: int) -> int:
    """Return the next of the environment's random numbers in 0..bound-1 (splitmix64)."""
    state = route.random_state[0] + uint64(_INCREMENT)
    route.random_state[0] = state
    state = (state ^ (state >> uint64(30))) * uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> uint64(27))) * uint64(0x94D049BB133111EB)
    state ^= state >> uint64(31)
    return int((state >> uint64(33)) % uint64(bound))


@inlined
def laid_position(route: RouteState) -> float:
    """Return how far the route is known, m along it."""
    last = route.piece_count[0] - 1
    return route.pieces[last, START_POSITION] + route.pieces[last, LENGTH]


@inlined
def append_piece(
    route: RouteState, x: float, y: float, heading: float, curvature: float, length: float, row: int, s: float
) -> None:
    """Add a piece at the end; nothing where it has no length."""
    if length < 1e-9:
        return
    last = route.piece_count[0]
    start = laid_position(route) if last > 0 else 0.0
    piece = route.pieces[last]
    piece[START_X], piece[START_Y], piece[START_HEADING] = x, y, heading
    piece[CURVATURE], piece[LENGTH], piece[START_POSITION] = curvature, length, start
    route.row[last], route.row_start[last] = row, s
    route.piece_count[0] = last + 1


@inner
def extend(graph: LaneGraph, route: RouteState) -> None:
    """Lay pieces until enough of the route ahead is known (or the room for pieces is used up)."""
    while (
        laid_position(route) < route.position[0] + KNOWN_AHEAD
        and route.piece_count[0] + _PIECES_OF_A_CHANGE + 2 < PIECES
    ):
        row, s = route.laid_row[0], route.laid_s[0]
        if _is_on_last_planned(route):
            _lay_past_destination(graph, route)
            continue
        beside = _next_change(graph, route)
        if beside >= 0:
            room = _room_for_change(graph, route, beside, s * graph.length[beside] / graph.length[row])
            if room > _TOO_SHORT:
                _lay_change(graph, route, row, beside, s, room)
                continue
        x, y, heading = lane_pose(graph, row, s)
        append_piece(route, x, y, heading, graph.curvature[row], graph.length[row] - s, row, s)
        following = _next_row(graph, route, row)
        if following == _NONE:
            return
        _go_to(route, following, 0.0)


@inlined
def _is_on_last_planned(route: RouteState) -> bool:
    """Tell whether the route ends on the plan's last row."""
    return route.plan_count[0] > 0 and route.plan_next[0] == route.plan_count[0] - 1


@inlined
def _lay_past_destination(graph: LaneGraph, route: RouteState) -> None:
    """Lay the plan's last row until a little after the destination; from there on turns are drawn."""
    row, s = route.laid_row[0], route.laid_s[0]
    end = min(max(route.destination_s[0], s) + _PAST_DESTINATION, graph.length[row])
    x, y, heading = lane_pose(graph, row, s)
    append_piece(route, x, y, heading, graph.curvature[row], end - s, row, s)
    route.laid_s[0] = end
    route.plan_count[0] = 0


@inlined
def _go_to(route: RouteState, row: int, s: float) -> None:
    """Let the route end on a row and follow it in the plan."""
    route.laid_row[0], route.laid_s[0] = row, s
    if route.plan_next[0] + 1 < route.plan_count[0]:
        route.plan_next[0] += 1
    else:
        route.plan_count[0] = 0
    note_arrival(route)


@inlined
def note_arrival(route: RouteState) -> None:
    """Find the destination's place along the route once the last row of the plan is reached."""
    if _is_on_last_planned(route):
        end = laid_position(route) if route.piece_count[0] > 0 else 0.0
        route.arrival[0] = end + max(route.destination_s[0] - route.laid_s[0], 0.0)


@inlined
def _is_successor(graph: LaneGraph, row: int, other: int) -> bool:
    """Tell whether a row leads to another."""
    for index in range(graph.successor_start[row], graph.successor_start[row + 1]):
        if graph.successor[index] == other:
            return True
    return False


@inlined
def _planned(route: RouteState, steps: int) -> int:
    """Return the planned row `steps` after the one on which the route ends, or -1."""
    place = route.plan_next[0] + steps
    return route.plan[place] if place < route.plan_count[0] else _NONE


@inlined
def _next_change(graph: LaneGraph, route: RouteState) -> int:
    """Return the row beside the present one to change to before its end, or -1.

    That is what the plan says; without one only a lane that ends is left, for the neighbour that goes on
    longest.
    """
    row = route.laid_row[0]
    left, right = graph.left[row], graph.right[row]
    planned = _planned(route, 1)
    if planned != _NONE:
        beside = planned in (left, right)
        return planned if beside and not _is_successor(graph, row, planned) else _NONE
    best, farthest = _NONE, route.dead_end_distance[row]
    if farthest == math.inf:
        return _NONE
    if left >= 0 and route.dead_end_distance[left] > farthest:
        best, farthest = left, route.dead_end_distance[left]
    if right >= 0 and route.dead_end_distance[right] > farthest:
        best = right
    return best


@inlined
def _next_row(graph: LaneGraph, route: RouteState, row: int) -> int:
    """Return the row to drive on to: the planned one, else one drawn among those that do not end; -1 none."""
    planned = _planned(route, 1)
    if planned != _NONE:
        if _is_successor(graph, row, planned):
            return planned
        # The plan was made for another map or leaves the lanes: from here on turns are drawn.
        route.plan_count[0] = 0
    first, last = graph.successor_start[row], graph.successor_start[row + 1]
    going_on = 0
    for index in range(first, last):
        going_on += route.dead_end_distance[graph.successor[index]] == math.inf
    if going_on == 0:
        return graph.successor[first + _draw_below(route, last - first)] if last > first else _NONE
    drawn = _draw_below(route, going_on) if going_on > 1 else 0
    for index in range(first, last):
        if route.dead_end_distance[graph.successor[index]] == math.inf:
            if drawn == 0:
                return graph.successor[index]
            drawn -= 1
    return _NONE


@inlined
def _following_in_change(graph: LaneGraph, route: RouteState, row: int, steps: int) -> int:
    """Return the row on which a lane change may go on after `row`, -1 in a junction or at a fork."""
    first = graph.successor_start[row]
    if graph.successor_start[row + 1] != first + 1:
        return _NONE
    following = graph.successor[first]
    if graph.movement[following] >= 0:
        return _NONE
    planned = _planned(route, steps)
    return following if planned in (_NONE, following) else _NONE


@inlined
def _room_for_change(graph: LaneGraph, route: RouteState, beside: int, s: float) -> float:
    """Return the metres that a change to row `beside` from `s` along it may take."""
    room, row = graph.length[beside] - s, beside
    for step in range(2, _PIECES_OF_A_CHANGE):
        if room >= CHANGE_LENGTH:
            break
        following = _following_in_change(graph, route, row, step)
        if following == _NONE:
            break
        room, row = room + graph.length[following], following
    further = _planned(route, 2)
    if further != _NONE and further in (graph.left[beside], graph.right[beside]):
        # The next change has to be made on this row too.
        room = 0.5 * (graph.length[beside] - s)
    elif further == _NONE and route.plan_count[0] > 0:
        # The destination is on this row.
        room = min(room, max(graph.length[beside] - s, _LEAST_CHANGE_LENGTH))
    return min(room, CHANGE_LENGTH)


@inlined
def _lay_change(graph: LaneGraph, route: RouteState, row: int, beside: int, s: float, room: float) -> None:
    """Lay an S from `s` metres along a row to `room` metres further on one beside it or one that follows."""
    target, target_s = beside, s * graph.length[beside] / graph.length[row]
    x, y, heading = lane_pose(graph, row, s)
    _go_to(route, target, target_s)
    # Where on the target's rows the S ends, and its two arcs from there.
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
        append_piece(route, x, y, heading, curvature, length, target, target_s)
        if length > 0.0:
            x, y, heading = _on_arc(x, y, heading, curvature, length)
        on_row = length / total * room
        along, driven, target_s = until, driven + on_row, target_s + on_row
        if along >= first_length:
            curvature = second_curvature
        if along >= total:
            break
        if target != end and target_s >= graph.length[target] - 1e-9:
            target, target_s = graph.successor[graph.successor_start[target]], 0.0
            _go_to(route, target, 0.0)
    while target != end:
        target = graph.successor[graph.successor_start[target]]
        _go_to(route, target, 0.0)
    route.laid_s[0] = end_s
    note_arrival(route)


@inlined
def _on_arc(
    x: float, y: float, heading: float, curvature: float, length: float
) -> tuple[float, float, float]:
    """Return the pose `length` metres along an arc or, with curvature 0, a line."""
    # The chord of an arc lies along the mean of its two headings.
    half = 0.5 * curvature * length
    chord = length if abs(half) < 1e-12 else length * math.sin(half) / half
    return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), heading + 2.0 * half


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
