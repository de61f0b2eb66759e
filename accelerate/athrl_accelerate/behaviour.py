"""What vehicles decide: highway-env's `act` of controlled, IDM and linear vehicles."""

import math

from athrl_driving.kernels.compilation import part, spliced

from athrl_accelerate.columns import (
    ACC_MAX,
    ACCELERATION,
    ACCELERATION_PARAMETERS,
    COMFORT_ACC_MAX,
    COMFORT_ACC_MIN,
    CONTROLLED,
    CRASHED,
    DELTA,
    DISTANCE_WANTED,
    ENABLE_LANE_CHANGE,
    HEADING,
    IDM,
    KIND,
    KP_A,
    KP_HEADING,
    KP_LATERAL,
    LANE,
    LANE_CHANGE_DELAY,
    LANE_CHANGE_MAX_BRAKING_IMPOSED,
    LANE_CHANGE_MIN_ACC_GAIN,
    LENGTH,
    LINEAR,
    MAX_STEERING_ANGLE,
    NONE,
    POLITENESS,
    ROUTE_END,
    ROUTE_HEAD,
    SPEED,
    STEERING,
    STEERING_PARAMETERS,
    TARGET_LANE,
    TARGET_SPEED,
    TAU_PURSUIT,
    TIME_WANTED,
    TIMER,
    VEHICLE,
    Rows,
    Scratch,
)
from athrl_accelerate.lanes import (
    FIRST_LANE,
    LANE_COUNT,
    SPEED_LIMIT,
    Network,
    clip,
    is_after_end,
    is_reachable_from,
    lane_coordinates,
    lane_heading,
    not_zero,
    wrap_to_pi,
)
from athrl_accelerate.neighbours import closing_speed, lane_distance, neighbours
from athrl_accelerate.routes import next_lane


@part
def act_as_controlled(rows: Rows, network: Network, row: int) -> bool:
    """Act as ControlledVehicle does without a new action; False where the route has no next lane."""
    state, parameters = rows.state, rows.parameters
    if not _follow_road(rows, network, row):
        return False
    state[STEERING, row] = steering_control(rows, network, row)
    state[ACCELERATION, row] = parameters[KP_A, row] * (state[TARGET_SPEED, row] - state[SPEED, row])
    return True


@part
def act_as_idm(
    rows: Rows, network: Network, scratch: Scratch, vehicles: int, count: int, connected: bool, row: int
) -> bool:
    """Act as IDMVehicle and LinearVehicle do; False where the route has no next lane."""
    marks, state, parameters = rows.marks, rows.state, rows.parameters
    if not _follow_road(rows, network, row):
        return False
    lane = marks[LANE, row]
    if marks[ENABLE_LANE_CHANGE, row]:
        if lane != marks[TARGET_LANE, row]:
            _abort_lane_change(rows, network, scratch, vehicles, row)
        elif parameters[LANE_CHANGE_DELAY, row] < state[TIMER, row]:
            _choose_lane(rows, network, scratch, count, connected, row)
    state[STEERING, row] = steering_control(rows, network, row)

    front, _ = neighbours(rows, network, scratch, count, connected, row, lane, scratch.along[row])
    acceleration = desired_acceleration(rows, network, scratch, row, row, front)
    target = marks[TARGET_LANE, row]
    if lane != target:
        along = lane_coordinates(network.lanes, target, scratch.x[row], scratch.y[row])[0]
        front, _ = neighbours(rows, network, scratch, count, connected, row, target, along)
        acceleration = min(acceleration, desired_acceleration(rows, network, scratch, row, row, front))
    most = parameters[ACC_MAX, row]
    state[ACCELERATION, row] = clip(acceleration, -most, most)
    return True


@spliced
def _follow_road(rows: Rows, network: Network, row: int) -> bool:
    """At the end of the target lane choose the next one; False where the route has no next lane."""
    target = rows.marks[TARGET_LANE, row]
    x, y = rows.position[row, 0], rows.position[row, 1]
    along = lane_coordinates(network.lanes, target, x, y)[0]
    if is_after_end(network.lanes, target, along):
        target = next_lane(rows, network, row, target, along)
        if target == NONE:
            return False
        rows.marks[TARGET_LANE, row] = target
    return True


@part
def steering_control(rows: Rows, network: Network, row: int) -> float:
    """Return the steering angle (rad) towards the middle of the target lane."""
    state, parameters = rows.state, rows.parameters
    lane = rows.marks[TARGET_LANE, row]
    speed = state[SPEED, row]
    divisor = not_zero(speed)
    length = parameters[LENGTH, row]
    most = parameters[MAX_STEERING_ANGLE, row]
    along, beside = lane_coordinates(network.lanes, lane, rows.position[row, 0], rows.position[row, 1])
    ahead = lane_heading(network.lanes, lane, along + speed * parameters[TAU_PURSUIT, row])
    if rows.marks[KIND, row] == LINEAR:
        angle = wrap_to_pi(ahead - state[HEADING, row]) * length / divisor
        offset = -beside * length / (divisor * divisor)
        first, second = parameters[STEERING_PARAMETERS, row], parameters[STEERING_PARAMETERS + 1, row]
        return clip(first * angle + second * offset, -most, most)
    lateral_speed = -parameters[KP_LATERAL, row] * beside
    towards = math.asin(clip(lateral_speed / divisor, -1.0, 1.0))
    reference = ahead + clip(towards, -math.pi / 4.0, math.pi / 4.0)
    rate = parameters[KP_HEADING, row] * wrap_to_pi(reference - state[HEADING, row])
    sine = clip(length / 2.0 / divisor * rate, -1.0, 1.0)
    # The tangent of the arc sine, computed without either function.
    cosine = math.sqrt((1.0 - sine) * (1.0 + sine))
    angle = math.atan2(2.0 * sine, cosine)
    return clip(angle, -most, most)


@part
def desired_acceleration(
    rows: Rows, network: Network, scratch: Scratch, judge: int, row: int, front: int
) -> float:
    """Return the acceleration (m/s2) of `row` behind `front` (or NONE), with the judge's parameters."""
    parameters = rows.parameters
    if rows.marks[KIND, judge] == LINEAR:
        return _linear_acceleration(rows, network, scratch, judge, row, front)
    if row == NONE or rows.marks[KIND, row] < VEHICLE:
        return 0.0
    speed = rows.state[SPEED, row]
    target = rows.state[TARGET_SPEED, row] if rows.marks[KIND, row] >= CONTROLLED else 0.0
    limit = network.lanes[rows.marks[LANE, row], SPEED_LIMIT]
    if not math.isnan(limit):
        target = clip(target, 0.0, limit)
    comfort = parameters[COMFORT_ACC_MAX, judge]
    ratio = max(speed, 0.0) / abs(not_zero(target))
    acceleration = comfort * (1.0 - ratio ** parameters[DELTA, judge])
    if front != NONE:
        distance = lane_distance(rows, network, scratch, row, front)
        share = _desired_gap(rows, scratch, judge, row, front) / not_zero(distance)
        acceleration -= comfort * (share * share)
    return acceleration


@spliced
def _linear_acceleration(rows, network, scratch, judge, row, front):  # type: ignore[no-untyped-def]
    if row == NONE:
        return 0.0
    parameters = rows.parameters
    speed = rows.state[SPEED, row]
    target = rows.state[TARGET_SPEED, row] if rows.marks[KIND, row] >= CONTROLLED else speed
    acceleration = parameters[ACCELERATION_PARAMETERS, judge] * (target - speed)
    if front != NONE:
        safe = parameters[DISTANCE_WANTED, judge] + max(speed, 0.0) * parameters[TIME_WANTED, judge]
        slower = min(rows.state[SPEED, front] - speed, 0.0)
        nearer = min(lane_distance(rows, network, scratch, row, front) - safe, 0.0)
        acceleration += parameters[ACCELERATION_PARAMETERS + 1, judge] * slower
        acceleration += parameters[ACCELERATION_PARAMETERS + 2, judge] * nearer
    return acceleration


@spliced
def _desired_gap(rows: Rows, scratch: Scratch, judge: int, row: int, front: int) -> float:
    """Return the distance (m) that IDM wants between `row` and `front`, with the judge's parameters."""
    parameters = rows.parameters
    product = -parameters[COMFORT_ACC_MAX, judge] * parameters[COMFORT_ACC_MIN, judge]
    speed = rows.state[SPEED, row]
    closing = closing_speed(rows, scratch, row, front)
    gap = parameters[DISTANCE_WANTED, judge] + speed * parameters[TIME_WANTED, judge]
    return gap + speed * closing / (2.0 * math.sqrt(product))


@spliced
def _abort_lane_change(rows: Rows, network: Network, scratch: Scratch, vehicles: int, row: int) -> None:
    """Stay on the lane if another vehicle close ahead is changing to the same lane."""
    marks = rows.marks
    lane, target = marks[LANE, row], marks[TARGET_LANE, row]
    if network.lane_road[lane] != network.lane_road[target]:
        return
    for other in range(vehicles):
        if marks[TARGET_LANE, other] != target or other == row:
            continue
        if marks[LANE, other] == target or marks[KIND, other] < CONTROLLED:
            continue
        distance = lane_distance(rows, network, scratch, row, other)
        if 0.0 < distance < _desired_gap(rows, scratch, row, row, other):
            marks[TARGET_LANE, row] = lane
            return


@spliced
def _choose_lane(
    rows: Rows, network: Network, scratch: Scratch, count: int, connected: bool, row: int
) -> None:
    """Take the lane to the left or to the right where MOBIL recommends it."""
    rows.state[TIMER, row] = 0.0
    lane = rows.marks[LANE, row]
    road = network.lane_road[lane]
    first = network.roads[road, FIRST_LANE]
    last = first + network.roads[road, LANE_COUNT] - 1
    for side in range(-1, 2, 2):
        candidate = lane + side
        if candidate < first or candidate > last or abs(rows.state[SPEED, row]) < 1.0:
            continue
        if not is_reachable_from(network.lanes, candidate, scratch.x[row], scratch.y[row]):
            continue
        if _is_worthwhile(rows, network, scratch, count, connected, row, candidate):
            rows.marks[TARGET_LANE, row] = candidate


@part
def _is_worthwhile(
    rows: Rows, network: Network, scratch: Scratch, count: int, connected: bool, row: int, candidate: int
) -> bool:
    """Return whether MOBIL recommends changing to a lane of the same road."""
    marks, parameters = rows.marks, rows.parameters
    lane = marks[LANE, row]
    imposed = -parameters[LANE_CHANGE_MAX_BRAKING_IMPOSED, row]
    along = lane_coordinates(network.lanes, candidate, scratch.x[row], scratch.y[row])[0]
    before, behind = neighbours(rows, network, scratch, count, connected, row, candidate, along)
    behind_then = desired_acceleration(rows, network, scratch, row, behind, row)
    if behind_then < imposed:
        return False
    own_then = desired_acceleration(rows, network, scratch, row, row, before)
    head = marks[ROUTE_HEAD, row]
    if head < marks[ROUTE_END, row] and rows.route[row, head, 2] != NONE:
        number = rows.route[row, head, 2]
        target = marks[TARGET_LANE, row]
        target_number = target - network.roads[network.lane_road[target], FIRST_LANE]
        candidate_number = candidate - network.roads[network.lane_road[candidate], FIRST_LANE]
        if _sign(candidate_number - target_number) != _sign(number - target_number):
            return False
        return not own_then < imposed
    old_front, old_rear = neighbours(rows, network, scratch, count, connected, row, lane, scratch.along[row])
    own_now = desired_acceleration(rows, network, scratch, row, row, old_front)
    behind_now = desired_acceleration(rows, network, scratch, row, behind, before)
    old_now = desired_acceleration(rows, network, scratch, row, old_rear, row)
    old_then = desired_acceleration(rows, network, scratch, row, old_rear, old_front)
    for_others = behind_then - behind_now + old_then - old_now
    gain = own_then - own_now + parameters[POLITENESS, row] * for_others
    return not gain < parameters[LANE_CHANGE_MIN_ACC_GAIN, row]


@spliced
def _sign(number):  # type: ignore[no-untyped-def]
    return (number > 0) - (number < 0)


@part
def act_all(
    rows: Rows, network: Network, scratch: Scratch, vehicles: int, count: int, connected: bool
) -> int:
    """Let all vehicles act in order; return the row whose route has no next lane, or NONE."""
    kinds = rows.marks[KIND]
    for row in range(vehicles):
        if kinds[row] >= IDM:
            if rows.marks[CRASHED, row] == 0 and not act_as_idm(
                rows, network, scratch, vehicles, count, connected, row
            ):
                return row
        elif kinds[row] == CONTROLLED and not act_as_controlled(rows, network, row):
            return row
    return NONE
