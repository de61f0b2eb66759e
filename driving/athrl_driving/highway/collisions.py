"""highway-env's collisions: which boxes touch or will touch, and how they push each other."""

import math

from athrl_driving.highway.compiling import part, whole
from athrl_driving.highway.columns import (
    CHECK_COLLISIONS,
    COLLIDABLE,
    CRASHED,
    DIAGONAL,
    HAS_IMPACT,
    HEADING,
    HIT,
    IMPACT_X,
    IMPACT_Y,
    KIND,
    LENGTH,
    OBSTACLE,
    SOLID,
    SPEED,
    WIDTH,
    Rows,
    Scratch,
)


@whole
def collide_all(rows: Rows, scratch: Scratch, vehicles: int, count: int, dt: float) -> None:
    """Handle the collisions of every vehicle with the later ones and with all objects, in highway-env's order."""
    x, y, radius = scratch.x, scratch.y, scratch.radius
    for row in range(count):
        x[row], y[row] = rows.position[row, 0], rows.position[row, 1]
        radius[row] = rows.state[DIAGONAL, row] / 2.0
    for row in range(vehicles):
        own_x, own_y = x[row], y[row]
        own_reach = radius[row] + rows.state[SPEED, row] * dt + 1e-6
        for other in range(row + 1, count):
            reach = radius[other] + own_reach
            east, south = x[other] - own_x, y[other] - own_y
            if east * east + south * south <= reach * reach:
                _collide(rows, row, other, dt)


@whole
def _collide(rows: Rows, row: int, other: int, dt: float) -> None:
    marks, state = rows.marks, rows.state
    if not (marks[CHECK_COLLISIONS, row] or marks[CHECK_COLLISIONS, other]):
        return
    if not (marks[COLLIDABLE, row] and marks[COLLIDABLE, other]):
        return
    east = rows.position[other, 0] - rows.position[row, 0]
    south = rows.position[other, 1] - rows.position[row, 1]
    reach = (state[DIAGONAL, row] + state[DIAGONAL, other]) / 2.0 + state[SPEED, row] * dt
    if math.sqrt(east * east + south * south) > reach:
        return
    touches, will_touch, push_x, push_y = boxes_touching(rows, row, other, dt)
    both_solid = marks[SOLID, row] and marks[SOLID, other]
    if will_touch and both_solid:
        if marks[KIND, other] == OBSTACLE:
            _push(rows, row, push_x, push_y)
        elif marks[KIND, row] == OBSTACLE:
            _push(rows, other, push_x, push_y)
        else:
            _push(rows, row, push_x / 2.0, push_y / 2.0)
            _push(rows, other, -push_x / 2.0, -push_y / 2.0)
    if touches:
        if both_solid:
            marks[CRASHED, row] = marks[CRASHED, other] = 1
        if not marks[SOLID, row]:
            marks[HIT, row] = 1
        if not marks[SOLID, other]:
            marks[HIT, other] = 1


@part
def _push(rows: Rows, row: int, push_x: float, push_y: float) -> None:
    rows.state[IMPACT_X, row], rows.state[IMPACT_Y, row] = push_x, push_y
    rows.marks[HAS_IMPACT, row] = 1


@whole
def boxes_touching(rows, row, other, dt):  # type: ignore[no-untyped-def]
    """Return whether two boxes touch, whether they will within dt seconds, and the push (m) that parts them.

    highway-env's separating axes: each box's four sides, each box's corners projected on them.
    """
    state, parameters = rows.state, rows.parameters
    touches = will_touch = True
    least = math.inf
    push_x, push_y = 0.0, 0.0
    first_x, first_y = rows.position[row, 0], rows.position[row, 1]
    second_x, second_y = rows.position[other, 0], rows.position[other, 1]
    first_cosine, first_sine = math.cos(state[HEADING, row]), math.sin(state[HEADING, row])
    second_cosine, second_sine = math.cos(state[HEADING, other]), math.sin(state[HEADING, other])
    first_length, first_width = parameters[LENGTH, row] / 2.0, parameters[WIDTH, row] / 2.0
    second_length, second_width = parameters[LENGTH, other] / 2.0, parameters[WIDTH, other] / 2.0
    first_speed, second_speed = state[SPEED, row] * dt, state[SPEED, other] * dt
    drift_x = first_speed * first_cosine - second_speed * second_cosine
    drift_y = first_speed * first_sine - second_speed * second_sine
    for side in range(8):
        cosine, sine = (first_cosine, first_sine) if side < 4 else (second_cosine, second_sine)
        # Sides from corner to corner: left end, right side, front end, left side, as highway-env lists them.
        if side % 4 == 0:
            axis_x, axis_y = -cosine, -sine
        elif side % 4 == 1:
            axis_x, axis_y = -sine, cosine
        elif side % 4 == 2:
            axis_x, axis_y = cosine, sine
        else:
            axis_x, axis_y = sine, -cosine
        first_middle = first_x * axis_x + first_y * axis_y
        first_extent = first_length * abs(first_cosine * axis_x + first_sine * axis_y)
        first_extent += first_width * abs(first_cosine * axis_y - first_sine * axis_x)
        second_middle = second_x * axis_x + second_y * axis_y
        second_extent = second_length * abs(second_cosine * axis_x + second_sine * axis_y)
        second_extent += second_width * abs(second_cosine * axis_y - second_sine * axis_x)
        low, high = first_middle - first_extent, first_middle + first_extent
        second_low, second_high = second_middle - second_extent, second_middle + second_extent
        if _interval_distance(low, high, second_low, second_high) > 0.0:
            touches = False
        drift = axis_x * drift_x + axis_y * drift_y
        if drift < 0.0:
            low += drift
        else:
            high += drift
        distance = _interval_distance(low, high, second_low, second_high)
        if distance > 0.0:
            will_touch = False
        if not touches and not will_touch:
            return False, False, 0.0, 0.0
        if abs(distance) < least:
            least = abs(distance)
            between = (first_x - second_x) * axis_x + (first_y - second_y) * axis_y
            push_x, push_y = (axis_x, axis_y) if between > 0.0 else (-axis_x, -axis_y)
    return touches, will_touch, least * push_x, least * push_y


@part
def _interval_distance(low, high, second_low, second_high):  # type: ignore[no-untyped-def]
    return second_low - high if low < second_low else low - second_high
