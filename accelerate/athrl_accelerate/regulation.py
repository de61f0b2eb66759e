"""highway-env's road rules: which vehicles would meet within three seconds, and which of them has to stop."""

import math

from athrl_driving.kernels.compilation import part, spliced

from athrl_accelerate.columns import (
    BICYCLE,
    CONTROLLED,
    HAS_YIELDED,
    HEADING,
    IS_MDP,
    IS_YIELDING,
    KIND,
    LANE,
    LENGTH,
    NONE,
    TARGET_SPEED,
    TRAJECTORY_POINTS,
    WIDTH,
    YIELD_TIMER,
    Rows,
    Scratch,
)
from athrl_accelerate.lanes import PRIORITY, SPEED_LIMIT, Network
from athrl_accelerate.motion import predict_steering
from athrl_accelerate.routes import predict_on_route

POINT_SPACING = 0.25
"""s between the points of a predicted trajectory."""
SLACK = 1e-6
"""m, for rounding."""


@part
def enforce_road_rules(
    rows: Rows, network: Network, scratch: Scratch, vehicles: int, yield_duration: float
) -> int:
    """Release vehicles that have yielded long enough and stop those that have to yield.

    `yield_duration` is in rounds of these rules. Returns the row without a route, or NONE.
    """
    marks, state = rows.marks, rows.state
    for row in range(vehicles):
        if not marks[IS_YIELDING, row]:
            continue
        if state[YIELD_TIMER, row] >= yield_duration:
            state[TARGET_SPEED, row] = network.lanes[marks[LANE, row], SPEED_LIMIT]
            marks[IS_YIELDING, row] = 0
        else:
            state[YIELD_TIMER, row] += 1.0
    if vehicles < 2:
        return NONE  # like highway-env, which then makes no predictions and finds no missing lane
    for row in range(vehicles):
        if not _predict(rows, network, scratch, row):
            return row
    reach = scratch.reach
    for first in range(vehicles - 1):
        # highway-env checks boxes whose centres are at most the first one's length apart.
        near = rows.parameters[LENGTH, first] + SLACK
        west, north = reach[first, 0] - near, reach[first, 1] - near
        east, south = reach[first, 2] + near, reach[first, 3] + near
        for second in range(first + 1, vehicles):
            if reach[second, 0] > east or reach[second, 2] < west:
                continue
            if reach[second, 1] > south or reach[second, 3] < north:
                continue
            if _is_conflict_possible(rows, scratch, first, second):
                _stop(rows, _yielding(rows, network, first, second))
    return NONE


@spliced
def _stop(rows: Rows, row: int) -> None:
    marks = rows.marks
    if marks[KIND, row] >= CONTROLLED and not marks[IS_MDP, row]:
        rows.state[TARGET_SPEED, row] = 0.0
        rows.state[YIELD_TIMER, row] = 0.0
        marks[IS_YIELDING, row] = marks[HAS_YIELDED, row] = 1


@spliced
def _yielding(rows: Rows, network: Network, first: int, second: int) -> int:
    """Return the row that yields: that of lower priority, else that which has the other further in front."""
    marks, position = rows.marks, rows.position
    one = network.lanes[marks[LANE, first], PRIORITY]
    two = network.lanes[marks[LANE, second], PRIORITY]
    if one != two:
        return second if one > two else first
    east, south = position[second, 0] - position[first, 0], position[second, 1] - position[first, 1]
    heading, other = rows.state[HEADING, first], rows.state[HEADING, second]
    ahead_of_first = math.cos(heading) * east + math.sin(heading) * south
    ahead_of_second = math.cos(other) * -east + math.sin(other) * -south
    return first if ahead_of_first > ahead_of_second else second


@part
def _predict(rows: Rows, network: Network, scratch: Scratch, row: int) -> bool:
    """Predict where a vehicle will be at constant speed; False where its route has a missing lane."""
    trajectory, reach = scratch.trajectory, scratch.reach
    if rows.marks[KIND, row] <= BICYCLE:
        predict_steering(rows, scratch, row, POINT_SPACING)
    elif not predict_on_route(rows, network, scratch, row, POINT_SPACING):
        return False
    reach[row, 0] = reach[row, 1] = math.inf
    reach[row, 2] = reach[row, 3] = -math.inf
    for point in range(TRAJECTORY_POINTS):
        x, y = trajectory[row, point, 0], trajectory[row, point, 1]
        reach[row, 0], reach[row, 1] = min(reach[row, 0], x), min(reach[row, 1], y)
        reach[row, 2], reach[row, 3] = max(reach[row, 2], x), max(reach[row, 3], y)
    return True


@part
def _is_conflict_possible(rows: Rows, scratch: Scratch, first: int, second: int) -> bool:
    """Return whether two predicted trajectories meet."""
    trajectory = scratch.trajectory
    near = rows.parameters[LENGTH, first]
    for point in range(TRAJECTORY_POINTS):
        east = trajectory[second, point, 0] - trajectory[first, point, 0]
        south = trajectory[second, point, 1] - trajectory[first, point, 1]
        if math.sqrt(east * east + south * south) > near:
            continue
        if _has_corner_inside(rows, trajectory, point, first, second):
            return True
        if _has_corner_inside(rows, trajectory, point, second, first):
            return True
    return False


@part
def _has_corner_inside(rows, trajectory, point, first, second):  # type: ignore[no-untyped-def]
    """Return whether a corner, a side's middle or the centre of the first box is inside the second."""
    half_length = 1.5 * rows.parameters[LENGTH, first] / 2.0
    half_width = 0.9 * rows.parameters[WIDTH, first] / 2.0
    reach_length = 1.5 * rows.parameters[LENGTH, second] / 2.0
    reach_width = 0.9 * rows.parameters[WIDTH, second] / 2.0
    cosine, sine = math.cos(trajectory[first, point, 2]), math.sin(trajectory[first, point, 2])
    turn_cosine, turn_sine = math.cos(trajectory[second, point, 2]), math.sin(trajectory[second, point, 2])
    for lengthwise in range(-1, 2):
        for crosswise in range(-1, 2):
            forward, sideways = lengthwise * half_length, crosswise * half_width
            east = cosine * forward - sine * sideways
            south = sine * forward + cosine * sideways
            east += trajectory[first, point, 0] - trajectory[second, point, 0]
            south += trajectory[first, point, 1] - trajectory[second, point, 1]
            # highway-env turns the point by the angle, not back by it.
            along = turn_cosine * east - turn_sine * south
            across = turn_sine * east + turn_cosine * south
            if abs(along) <= reach_length and abs(across) <= reach_width:
                return True
    return False
