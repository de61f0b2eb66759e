"""Which lane follows a lane: highway-env's `next_lane`, and where a route leads at a distance."""

import math

from athrl_driving.highway.columns import LANE, NONE, ROUTE_END, ROUTE_HEAD, Rows
from athrl_driving.highway.compiling import part, whole
from athrl_driving.highway.lanes import (
    FIRST_LANE,
    FROM_NODE,
    LANE_COUNT,
    LANE_LENGTH,
    TO_NODE,
    Network,
    distance_to_lane,
    lane_centre,
    lane_heading,
)


@part
def road_between(network: Network, origin: int, destination: int) -> int:
    """Return the road from one node to another, or NONE."""
    if not 0 <= origin < len(network.node_roads):
        return NONE
    first = network.node_roads[origin, 0]
    for road in range(first, first + network.node_roads[origin, 1]):
        if network.roads[road, TO_NODE] == destination:
            return road
    return NONE


@whole
def next_lane(rows: Rows, network: Network, row: int, lane: int, along: float) -> int:
    """Return the lane to follow after `lane`, on which the vehicle is at `along` (m).

    Drops the first road of the route once it has been driven. NONE where the route names a road or a lane
    that is not there.
    """
    marks, roads, route = rows.marks, network.roads, rows.route
    road = network.lane_road[lane]
    head, end = marks[ROUTE_HEAD, row], marks[ROUTE_END, row]
    planned, number = NONE, NONE
    node = roads[road, TO_NODE]
    if head < end and route[row, head, 0] == roads[road, FROM_NODE] and route[row, head, 1] == node:
        head += 1
        marks[ROUTE_HEAD, row] = head
    x, y = lane_centre(network.lanes, lane, along)
    if head < end and route[row, head, 0] == node:
        planned, number = road_between(network, node, route[row, head, 1]), route[row, head, 2]
        if planned == NONE:
            return NONE
        return _lane_of_road(network, lane, planned, number, x, y)
    best, best_lane = math.inf, lane
    first = network.node_roads[node, 0]
    for following in range(first, first + network.node_roads[node, 1]):
        candidate = _lane_of_road(network, lane, following, NONE, x, y)
        distance = distance_to_lane(network.lanes, candidate, x, y)
        if distance < best:
            best, best_lane = distance, candidate
    return best_lane


@whole
def _lane_of_road(network: Network, lane: int, following: int, number: int, x: float, y: float) -> int:
    """Return the lane of the following road: the planned one, the same one, or the one that is closest."""
    roads = network.roads
    road = network.lane_road[lane]
    first, lanes = roads[following, FIRST_LANE], roads[following, LANE_COUNT]
    if roads[road, LANE_COUNT] == lanes:
        if number == NONE:
            number = lane - roads[road, FIRST_LANE]
        return first + number if number < lanes else NONE
    best, best_lane = math.inf, first
    for candidate in range(first, first + lanes):
        distance = distance_to_lane(network.lanes, candidate, x, y)
        if distance < best:
            best, best_lane = distance, candidate
    return best_lane


@whole
def pose_on_route(rows: Rows, network: Network, row: int, along: float) -> tuple[float, float, float]:
    """Return where (x, y in m, heading) a vehicle is that follows its route's lanes for `along` m.

    `along` counts from the start of the route's first road. Not a number where the route names a lane that
    is not there.
    """
    head, end = rows.marks[ROUTE_HEAD, row], rows.marks[ROUTE_END, row]
    lane = rows.marks[LANE, row]
    if head >= end:
        x, y = lane_centre(network.lanes, lane, along)
        return x, y, lane_heading(network.lanes, lane, along)
    own_number = lane - network.roads[network.lane_road[lane], FIRST_LANE]
    while True:
        road = road_between(network, rows.route[row, head, 0], rows.route[row, head, 1])
        number = rows.route[row, head, 2]
        if number == NONE:
            number = own_number
        if road == NONE or number >= network.roads[road, LANE_COUNT]:
            return math.nan, math.nan, math.nan
        lane = network.roads[road, FIRST_LANE] + number
        length = network.lanes[lane, LANE_LENGTH]
        if head + 1 >= end or not along > length:
            break
        along -= length
        head += 1
    x, y = lane_centre(network.lanes, lane, along)
    return x, y, lane_heading(network.lanes, lane, along)
