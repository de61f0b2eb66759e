"""The neighbours before and behind a vehicle on a lane.

highway-env computes every vehicle's coordinates on the lane for every query. Here each lane that is queried
in a frame gets one list of the vehicles and objects on it, sorted along it; a query is then a binary search.
Of vehicles side by side, highway-env's loop prefers the last of the list in front and the first behind.
"""

import math

from athrl_driving.kernels.compilation import part, spliced

from athrl_accelerate.columns import (
    FRAME,
    HEADING,
    KIND,
    LANDMARK,
    LANE,
    LIST,
    NONE,
    POOL_USED,
    SPEED,
    Rows,
    Scratch,
)
from athrl_accelerate.lanes import (
    AMPLITUDE,
    CIRCULAR,
    DIRECTION_X,
    DIRECTION_Y,
    LANE_LENGTH,
    LANE_WIDTH,
    ORIGIN_X,
    ORIGIN_Y,
    RADIUS,
    SHAPE,
    VEHICLE_LENGTH,
    Network,
    lane_coordinates,
)

SLACK = 1e-3
"""m, for rounding."""
MARGIN = 1.0
"""m beside a lane within which a vehicle still counts as on it."""


@spliced
def begin_frame(rows: Rows, network: Network, scratch: Scratch, count: int) -> None:
    """Store where everything is, and discard the lists of the previous frame."""
    for row in range(count):
        x, y = rows.position[row, 0], rows.position[row, 1]
        heading = rows.state[HEADING, row]
        scratch.x[row], scratch.y[row] = x, y
        scratch.cosine[row], scratch.sine[row] = math.cos(heading), math.sin(heading)
        scratch.along[row] = lane_coordinates(network.lanes, rows.marks[LANE, row], x, y)[0]
    scratch.counters[FRAME] += 1
    scratch.counters[POOL_USED] = 0


@part
def neighbours(
    rows: Rows,
    network: Network,
    scratch: Scratch,
    count: int,
    connected: bool,
    row: int,
    lane: int,
    along: float,
) -> tuple[int, int]:
    """Return the rows before and behind a vehicle at `along` (m) on a lane, or NONE."""
    listed = scratch.listed
    if listed[lane, 0] != scratch.counters[FRAME]:
        _list_lane(rows, network, scratch, count, connected, lane)
    start, end = listed[lane, 1], listed[lane, 2]
    pool_along, pool_row = scratch.pool_along, scratch.pool_row
    low, high = start, end
    while low < high:
        middle = (low + high) // 2
        if pool_along[middle] < along:
            low = middle + 1
        else:
            high = middle
    front, rear = NONE, NONE
    reached = 0.0
    index = low
    while index < end:
        if pool_row[index] != row:
            if front != NONE and pool_along[index] != reached:
                break
            front, reached = pool_row[index], pool_along[index]
        index += 1
    index = low - 1
    while index >= start:
        if pool_row[index] != row:
            if rear != NONE and pool_along[index] != reached:
                break
            rear, reached = pool_row[index], pool_along[index]
        index -= 1
    return front, rear


@part
def _list_lane(
    rows: Rows, network: Network, scratch: Scratch, count: int, connected: bool, lane: int
) -> None:
    """List the rows on a lane, then those on lanes connected to it, sorted by their position along it."""
    if scratch.counters[POOL_USED] + count > len(scratch.pool_row):
        # The pool is full: discard all lists; they are made again when they are needed.
        scratch.counters[FRAME] += 1
        scratch.counters[POOL_USED] = 0
    scratch.counters[LIST] += 1
    start = scratch.counters[POOL_USED]
    end = _list_rows(rows, network, scratch, count, lane, 0.0, start, start)
    if connected:
        for index in range(network.connected_start[lane], network.connected_start[lane + 1]):
            other, offset = network.connected_lane[index], network.connected_offset[index]
            end = _list_rows(rows, network, scratch, count, other, offset, start, end)
    listed = scratch.listed
    listed[lane, 0], listed[lane, 1], listed[lane, 2] = scratch.counters[FRAME], start, end
    scratch.counters[POOL_USED] = end


@part
def _list_rows(
    rows: Rows,
    network: Network,
    scratch: Scratch,
    count: int,
    lane: int,
    offset: float,
    start: int,
    end: int,
) -> int:
    """Add the rows on a lane that are not yet in the list from `start` to the list; return its new end."""
    lanes, near, member = network.lanes, scratch.near, scratch.member
    pool_along, pool_row = scratch.pool_along, scratch.pool_row
    if _mark_near(lanes, lane, scratch.x, scratch.y, near, count) == 0:
        return end
    room = lanes[lane, LANE_WIDTH] / 2.0 + MARGIN
    before, after = -lanes[lane, VEHICLE_LENGTH], lanes[lane, LANE_LENGTH] + lanes[lane, VEHICLE_LENGTH]
    for row in range(count):
        if not near[row] or member[row] == scratch.counters[LIST] or rows.marks[KIND, row] == LANDMARK:
            continue
        along, beside = lane_coordinates(lanes, lane, scratch.x[row], scratch.y[row])
        if abs(beside) > room or along < before or along >= after:
            continue
        member[row] = scratch.counters[LIST]
        along += offset
        place = end
        while place > start and (
            pool_along[place - 1] > along or (pool_along[place - 1] == along and pool_row[place - 1] > row)
        ):
            pool_along[place], pool_row[place] = pool_along[place - 1], pool_row[place - 1]
            place -= 1
        pool_along[place], pool_row[place] = along, row
        end += 1
    return end


@part
def _mark_near(lanes, lane, x, y, near, count):  # type: ignore[no-untyped-def]
    """Mark the rows that can be on a lane by a vectorised test; return how many there are."""
    room = lanes[lane, LANE_WIDTH] / 2.0 + MARGIN + SLACK
    origin_x, origin_y = lanes[lane, ORIGIN_X], lanes[lane, ORIGIN_Y]
    number = 0
    if lanes[lane, SHAPE] == CIRCULAR:
        outside = lanes[lane, RADIUS] + room
        inside = max(lanes[lane, RADIUS] - room, 0.0)
        for row in range(count):
            east, south = x[row] - origin_x, y[row] - origin_y
            distance = east * east + south * south
            near[row] = (distance <= outside * outside) & (distance >= inside * inside)
            number += near[row]
        return number
    direction_x, direction_y = lanes[lane, DIRECTION_X], lanes[lane, DIRECTION_Y]
    before = -lanes[lane, VEHICLE_LENGTH] - SLACK
    after = lanes[lane, LANE_LENGTH] + lanes[lane, VEHICLE_LENGTH] + SLACK
    room += abs(lanes[lane, AMPLITUDE])
    for row in range(count):
        east, south = x[row] - origin_x, y[row] - origin_y
        along = east * direction_x + south * direction_y
        beside = south * direction_x - east * direction_y
        near[row] = (along >= before) & (along <= after) & (abs(beside) <= room)
        number += near[row]
    return number


@spliced
def lane_distance(rows: Rows, network: Network, scratch: Scratch, row: int, other: int) -> float:
    """Return how far `other` is ahead of `row`, m along the lane of `row`."""
    lane = rows.marks[LANE, row]
    return lane_coordinates(network.lanes, lane, scratch.x[other], scratch.y[other])[0] - scratch.along[row]


@spliced
def closing_speed(rows: Rows, scratch: Scratch, row: int, other: int) -> float:
    """Return how fast `row` approaches `other`, m/s in the direction of `row`."""
    speed, other_speed = rows.state[SPEED, row], rows.state[SPEED, other]
    east = speed * scratch.cosine[row] - other_speed * scratch.cosine[other]
    south = speed * scratch.sine[row] - other_speed * scratch.sine[other]
    return east * scratch.cosine[row] + south * scratch.sine[row]
