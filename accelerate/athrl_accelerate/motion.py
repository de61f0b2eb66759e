"""How vehicles move: highway-env's `step` of its kinematic and its dynamic bicycle model."""

import math

from athrl_driving.kernels.compilation import part, spliced

from athrl_accelerate.columns import (
    ACCELERATION,
    BICYCLE,
    CRASHED,
    FRICTION_FRONT,
    FRICTION_REAR,
    HAS_IMPACT,
    HEADING,
    IDM,
    IMPACT_X,
    IMPACT_Y,
    INERTIA_Z,
    KIND,
    LANE,
    LATERAL_SPEED,
    LENGTH,
    LENGTH_A,
    LENGTH_B,
    MASS,
    MAX_ANGULAR_SPEED,
    MAX_SPEED,
    MIN_SPEED,
    PREDICTS_STEERING,
    SPEED,
    STEERING,
    TIMER,
    TRAJECTORY_POINTS,
    YAW_RATE,
    Rows,
    Scratch,
)
from athrl_accelerate.lanes import Network, clip, closest_lane


@part
def move_all(rows: Rows, network: Network, vehicles: int, dt: float) -> None:
    """Move all vehicles by dt seconds and find their lanes."""
    marks, state, position = rows.marks, rows.state, rows.position
    for row in range(vehicles):
        if marks[KIND, row] >= IDM:
            state[TIMER, row] += dt
        clip_action(rows, row)
        if marks[KIND, row] == BICYCLE:
            _move_dynamically(rows, row, dt)
        else:
            _move(rows, row, dt)
        x, y = position[row, 0], position[row, 1]
        marks[LANE, row] = closest_lane(network, x, y, state[HEADING, row], marks[LANE, row])


@spliced
def clip_action(rows: Rows, row: int) -> None:
    """Let a crashed vehicle brake, and keep speeds within their bounds."""
    state = rows.state
    speed = state[SPEED, row]
    if rows.marks[CRASHED, row]:
        state[STEERING, row], state[ACCELERATION, row] = 0.0, -1.0 * speed
    fastest, slowest = rows.parameters[MAX_SPEED, row], rows.parameters[MIN_SPEED, row]
    if speed > fastest:
        state[ACCELERATION, row] = min(state[ACCELERATION, row], fastest - speed)
    elif speed < slowest:
        state[ACCELERATION, row] = max(state[ACCELERATION, row], slowest - speed)
    if rows.marks[KIND, row] == BICYCLE:
        quickest = rows.parameters[MAX_ANGULAR_SPEED, row]
        state[STEERING, row] = clip(state[STEERING, row], -math.pi / 2.0, math.pi / 2.0)
        state[YAW_RATE, row] = clip(state[YAW_RATE, row], -quickest, quickest)


@spliced
def _move(rows: Rows, row: int, dt: float) -> None:
    state, position = rows.state, rows.position
    speed, heading = state[SPEED, row], state[HEADING, row]
    slip = math.atan(0.5 * math.tan(state[STEERING, row]))
    position[row, 0] += speed * math.cos(heading + slip) * dt
    position[row, 1] += speed * math.sin(heading + slip) * dt
    if rows.marks[HAS_IMPACT, row]:
        position[row, 0] += state[IMPACT_X, row]
        position[row, 1] += state[IMPACT_Y, row]
        rows.marks[CRASHED, row], rows.marks[HAS_IMPACT, row] = 1, 0
    state[HEADING, row] += speed * math.sin(slip) / (rows.parameters[LENGTH, row] / 2.0) * dt
    state[SPEED, row] += state[ACCELERATION, row] * dt


@part
def _move_dynamically(rows: Rows, row: int, dt: float) -> None:
    """Integrate the dynamic model by the fourth-order Runge-Kutta method."""
    state, position = rows.state, rows.position
    start = (
        position[row, 0],
        position[row, 1],
        state[HEADING, row],
        state[SPEED, row],
        state[LATERAL_SPEED, row],
        state[YAW_RATE, row],
    )
    one = _derivative(rows, row, start)
    two = _derivative(rows, row, _advanced(start, one, dt / 2.0))
    three = _derivative(rows, row, _advanced(start, two, dt / 2.0))
    four = _derivative(rows, row, _advanced(start, three, dt))
    sixth = dt / 6.0
    position[row, 0] = start[0] + sixth * (one[0] + 2.0 * two[0] + 2.0 * three[0] + four[0])
    position[row, 1] = start[1] + sixth * (one[1] + 2.0 * two[1] + 2.0 * three[1] + four[1])
    state[HEADING, row] = start[2] + sixth * (one[2] + 2.0 * two[2] + 2.0 * three[2] + four[2])
    state[SPEED, row] = start[3] + sixth * (one[3] + 2.0 * two[3] + 2.0 * three[3] + four[3])
    state[LATERAL_SPEED, row] = start[4] + sixth * (one[4] + 2.0 * two[4] + 2.0 * three[4] + four[4])
    state[YAW_RATE, row] = start[5] + sixth * (one[5] + 2.0 * two[5] + 2.0 * three[5] + four[5])


@spliced
def _advanced(start, change, step):  # type: ignore[no-untyped-def]
    return (
        start[0] + change[0] * step,
        start[1] + change[1] * step,
        start[2] + change[2] * step,
        start[3] + change[3] * step,
        start[4] + change[4] * step,
        start[5] + change[5] * step,
    )


@part
def _derivative(rows, row, moving):  # type: ignore[no-untyped-def]
    """Return the rates of change of position, heading, speed, lateral speed and yaw rate, per second."""
    parameters = rows.parameters
    _, _, heading, speed, lateral, yaw = moving
    front, rear = parameters[LENGTH_A, row], parameters[LENGTH_B, row]
    mass, inertia = parameters[MASS, row], parameters[INERTIA_Z, row]
    if abs(speed) < 1.0:
        force_front = -mass * lateral - inertia / front * yaw
        force_rear = -mass * lateral + inertia / front * yaw
    else:
        slip_front = rows.state[STEERING, row] - math.atan2(lateral + front * yaw, speed)
        slip_rear = -math.atan2(lateral - rear * yaw, speed)
        force_front = 2.0 * parameters[FRICTION_FRONT, row] * slip_front
        force_rear = 2.0 * parameters[FRICTION_REAR, row] * slip_rear
    cosine, sine = math.cos(heading), math.sin(heading)
    return (
        cosine * speed - sine * lateral,
        sine * speed + cosine * lateral,
        yaw,
        rows.state[ACCELERATION, row],
        1.0 / mass * (force_front + force_rear) - yaw * speed,
        1.0 / inertia * (front * force_front - rear * force_rear),
    )


@part
def predict_steering(rows: Rows, scratch: Scratch, row: int, spacing: float) -> None:
    """Predict an uncontrolled vehicle's trajectory by moving it with constant steering, then restore it."""
    marks, state, position = rows.marks, rows.state, rows.position
    kept_x, kept_y = position[row, 0], position[row, 1]
    heading, speed = state[HEADING, row], state[SPEED, row]
    steering, acceleration = state[STEERING, row], state[ACCELERATION, row]
    lateral, yaw = state[LATERAL_SPEED, row], state[YAW_RATE, row]
    crashed, impact = marks[CRASHED, row], marks[HAS_IMPACT, row]
    state[ACCELERATION, row] = 0.0
    if not marks[PREDICTS_STEERING, row]:
        state[STEERING, row] = 0.0
    for point in range(TRAJECTORY_POINTS):
        clip_action(rows, row)
        if marks[KIND, row] == BICYCLE:
            _move_dynamically(rows, row, spacing)
        else:
            _move(rows, row, spacing)
        scratch.trajectory[row, point, 0] = position[row, 0]
        scratch.trajectory[row, point, 1] = position[row, 1]
        scratch.trajectory[row, point, 2] = state[HEADING, row]
    position[row, 0], position[row, 1] = kept_x, kept_y
    state[HEADING, row], state[SPEED, row] = heading, speed
    state[STEERING, row], state[ACCELERATION, row] = steering, acceleration
    state[LATERAL_SPEED, row], state[YAW_RATE, row] = lateral, yaw
    marks[CRASHED, row], marks[HAS_IMPACT, row] = crashed, impact
