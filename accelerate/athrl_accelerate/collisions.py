"""highway-env's collisions: which boxes touch or will touch, and how they push each other."""

import math

from athrl_driving.kernels.compilation import part, spliced

from athrl_accelerate.columns import (
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


@part
def collide_all(rows: Rows, scratch: Scratch, vehicles: int, count: int, dt: float) -> None:
    """Handle collisions of every vehicle with the later ones, then with all objects, as highway-env does."""
    x, y, radius = scratch.x, scratch.y, scratch.radius
    for row in range(count):
        x[row], y[row] = rows.position[row, 0], rows.position[row, 1]
        radius[row] = rows.state[DIAGONAL, row] / 2.0
    for row in range(vehicles):
        own_x, own_y = x[row], y[row]
        own_reach = radius[row] + rows.state[SPEED, row] * dt + 1e-6
        # Counting first is vectorised, and most vehicles are close to no other.
        close = 0
        for other in range(row + 1, count):
            reach = radius[other] + own_reach
            east, south = x[other] - own_x, y[other] - own_y
            close += east * east + south * south <= reach * reach
        if close == 0:
            continue
        for other in range(row + 1, count):
            reach = radius[other] + own_reach
            east, south = x[other] - own_x, y[other] - own_y
            if east * east + south * south <= reach * reach:
                _collide(rows, scratch, row, other, dt)


@part
def _collide(rows: Rows, scratch: Scratch, row: int, other: int, dt: float) -> None:
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
    touches, will_touch, push_x, push_y = boxes_touching(rows, scratch, row, other, dt)
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


@spliced
def _push(rows: Rows, row: int, push_x: float, push_y: float) -> None:
    rows.state[IMPACT_X, row], rows.state[IMPACT_Y, row] = push_x, push_y
    rows.marks[HAS_IMPACT, row] = 1


@part
def boxes_touching(rows, scratch, row, other, dt):  # type: ignore[no-untyped-def]
    """Return whether two boxes touch, whether they will within dt seconds, and the push (m) that parts them.

    highway-env's separating axes, with sums in the same order: a push leaves two boxes that just touch, and
    in the next frame the last bit decides whether they still do.
    """
    state, corners = rows.state, scratch.corners
    _write_corners(rows, corners, 0, row)
    _write_corners(rows, corners, 5, other)
    touches = will_touch = True
    least = math.inf
    push_x, push_y = 0.0, 0.0
    heading, other_heading = state[HEADING, row], state[HEADING, other]
    speed, other_speed = state[SPEED, row], state[SPEED, other]
    drift_x = speed * math.cos(heading) * dt - other_speed * math.cos(other_heading) * dt
    drift_y = speed * math.sin(heading) * dt - other_speed * math.sin(other_heading) * dt
    between_x = _mean(corners, 0, 0) - _mean(corners, 5, 0)
    between_y = _mean(corners, 0, 1) - _mean(corners, 5, 1)
    for corner in range(9):
        if corner == 4:
            continue  # from the last corner of the first box to the first of the second one
        axis_x = -corners[corner + 1, 1] + corners[corner, 1]
        axis_y = corners[corner + 1, 0] - corners[corner, 0]
        norm = math.sqrt(axis_x * axis_x + axis_y * axis_y)
        axis_x, axis_y = axis_x / norm, axis_y / norm
        low, high = _projection(corners, 0, axis_x, axis_y)
        other_low, other_high = _projection(corners, 5, axis_x, axis_y)
        if _interval_distance(low, high, other_low, other_high) > 0.0:
            touches = False
        drift = axis_x * drift_x + axis_y * drift_y
        if drift < 0.0:
            low += drift
        else:
            high += drift
        distance = _interval_distance(low, high, other_low, other_high)
        if distance > 0.0:
            will_touch = False
        if not touches and not will_touch:
            return False, False, 0.0, 0.0
        if abs(distance) < least:
            least = abs(distance)
            push_x, push_y = axis_x, axis_y
            if not between_x * axis_x + between_y * axis_y > 0.0:
                push_x, push_y = -axis_x, -axis_y
    return touches, will_touch, least * push_x, least * push_y


@spliced
def _write_corners(rows, corners, first, row):  # type: ignore[no-untyped-def]
    """Write a box's corners (x, y in m) in highway-env's order, with the first one repeated at the end."""
    cosine, sine = math.cos(rows.state[HEADING, row]), math.sin(rows.state[HEADING, row])
    x, y = rows.position[row, 0], rows.position[row, 1]
    for corner in range(5):
        forward = rows.parameters[LENGTH, row] / 2.0 * (1.0 if corner == 2 or corner == 3 else -1.0)
        sideways = rows.parameters[WIDTH, row] / 2.0 * (1.0 if corner == 1 or corner == 2 else -1.0)
        corners[first + corner, 0] = cosine * forward - sine * sideways + x
        corners[first + corner, 1] = sine * forward + cosine * sideways + y


@spliced
def _mean(corners, first, coordinate):  # type: ignore[no-untyped-def]
    total = corners[first, coordinate] + corners[first + 1, coordinate]
    total += corners[first + 2, coordinate]
    return (total + corners[first + 3, coordinate]) / 4.0


@spliced
def _projection(corners, first, axis_x, axis_y):  # type: ignore[no-untyped-def]
    """Return the least and greatest of a box's corners along an axis, m."""
    low, high = math.inf, -math.inf
    for corner in range(first, first + 4):
        along = corners[corner, 0] * axis_x + corners[corner, 1] * axis_y
        low, high = min(low, along), max(high, along)
    return low, high


@spliced
def _interval_distance(low, high, second_low, second_high):  # type: ignore[no-untyped-def]
    return second_low - high if low < second_low else low - second_high
