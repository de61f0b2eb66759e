"""The next lane of a route: highway-env's `next_lane`, and predicted positions on a route."""

import math

from athrl_driving.kernels.compilation import part, spliced

from athrl_accelerate.columns import (
    LANE,
    NONE,
    ROUTE_END,
    ROUTE_HEAD,
    SPEED,
    TRAJECTORY_POINTS,
    Rows,
    Scratch,
)
from athrl_accelerate.lanes import (
    FIRST_LANE,
    FROM_NODE,
    LANE_COUNT,
    LANE_LENGTH,
    TO_NODE,
    Network,
    distance_to_lane,
    lane_centre,
    lane_coordinates,
    lane_heading,
)


@spliced
def road_between(network: Network, origin: int, destination: int) -> int:
    """Return the road from one node to another, or NONE."""
    if not 0 <= origin < len(network.node_roads):
        return NONE
    first = network.node_roads[origin, 0]
    for road in range(first, first + network.node_roads[origin, 1]):
        if network.roads[road, TO_NODE] == destination:
            return road
    return NONE


@part
def next_lane(rows: Rows, network: Network, row: int, lane: int, along: float) -> int:
    """Return the lane to follow after `lane`, on which the vehicle is at `along` (m).

    Drops the first road of the route once it has been driven. NONE where the route names a road or a lane
    that does not exist.
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


@part
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


@part
def lane_of_route(rows: Rows, network: Network, row: int, place: int) -> int:
    """Return the lane at a place of a route (the vehicle's own where it has none), or NONE."""
    lane = rows.marks[LANE, row]
    if rows.marks[ROUTE_HEAD, row] >= rows.marks[ROUTE_END, row]:
        return lane
    road = road_between(network, rows.route[row, place, 0], rows.route[row, place, 1])
    number = rows.route[row, place, 2]
    if number == NONE:
        number = lane - network.roads[network.lane_road[lane], FIRST_LANE]
    if road == NONE or number >= network.roads[road, LANE_COUNT]:
        return NONE
    return network.roads[road, FIRST_LANE] + number


@part
def predict_on_route(rows: Rows, network: Network, scratch: Scratch, row: int, spacing: float) -> bool:
    """Predict positions of a vehicle that follows its route's lanes at constant speed, `spacing` s apart.

    As in highway-env it is assumed to be on the route's first road. False where the route names a lane that
    does not exist.
    """
    lanes, trajectory = network.lanes, scratch.trajectory
    own, head = rows.marks[LANE, row], rows.marks[ROUTE_HEAD, row]
    last = rows.marks[ROUTE_END, row] - 1
    start = lane_coordinates(lanes, own, rows.position[row, 0], rows.position[row, 1])[0]
    first_lane = lane_of_route(rows, network, row, head)
    if first_lane == NONE:
        return False
    for point in range(TRAJECTORY_POINTS):
        along = start + rows.state[SPEED, row] * (spacing * (point + 1))
        lane, place = first_lane, head
        while place < last and along > lanes[lane, LANE_LENGTH]:
            along -= lanes[lane, LANE_LENGTH]
            place += 1
            lane = lane_of_route(rows, network, row, place)
            if lane == NONE:
                return False
        trajectory[row, point, 0], trajectory[row, point, 1] = lane_centre(lanes, lane, along)
        trajectory[row, point, 2] = lane_heading(lanes, lane, along)
    return True
