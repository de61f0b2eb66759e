"""highway-env's lanes as rows of numbers; the arithmetic is that of its lane classes, in their order."""

import math
from typing import NamedTuple

from athrl_driving.kernels.compilation import part, spliced

from athrl_accelerate.columns import Floats, Integers

# float64 [L, LANE_COLUMNS]
SHAPE = 0
ORIGIN_X = 1
ORIGIN_Y = 2
"""Where a straight or sine lane starts, or the centre of a circular one, m."""
DIRECTION_X = 3
DIRECTION_Y = 4
LANE_HEADING = 5
AMPLITUDE = 6
PULSATION = 7
PHASE = 8
RADIUS = 9
START_PHASE = 10
TURN = 11
"""1 clockwise, -1 otherwise."""
LANE_LENGTH = 12
LANE_WIDTH = 13
SPEED_LIMIT = 14
"""m/s; not a number where there is none."""
PRIORITY = 15
FORBIDDEN = 16
VEHICLE_LENGTH = 17
LANE_COLUMNS = 18

STRAIGHT = 0.0
SINE = 1.0
CIRCULAR = 2.0

# int64 [R, 4]
FIRST_LANE = 0
LANE_COUNT = 1
FROM_NODE = 2
TO_NODE = 3


class Network(NamedTuple):
    """A road network: lanes in the graph's order, so a road's lanes and a node's roads adjoin."""

    lanes: Floats
    """[L, LANE_COLUMNS]."""
    lane_road: Integers
    """[L] the road of each lane."""
    roads: Integers
    """[R, 4] first lane, number of lanes, node from which it leads, node to which it leads."""
    node_roads: Integers
    """[nodes, 2] the first of the roads that leave a node, and their number."""
    grid: Floats
    """[3] x and y of the grid's corner, m, and cells a metre."""
    grid_shape: Integers
    """[2] columns and rows of cells; 0 where there is no grid and every lane is searched."""
    cell_start: Integers
    """[cells+1] into `cell_lane`."""
    cell_lane: Integers
    """The lanes that can be the closest one somewhere in a cell."""
    connected_start: Integers
    """[L+1] into the next two."""
    connected_lane: Integers
    """The lanes after and before a lane, on which highway-env searches for neighbours if set to do so."""
    connected_offset: Floats
    """m, from their coordinate to the lane's."""


@spliced
def wrap_to_pi(angle):  # type: ignore[no-untyped-def]
    """Wrap an angle as highway-env does."""
    turned = angle + math.pi
    if 0.0 <= turned < 2.0 * math.pi:
        return turned - math.pi  # equal to the remainder, without its cost
    return turned % (2.0 * math.pi) - math.pi


@spliced
def not_zero(value):  # type: ignore[no-untyped-def]
    """Keep a divisor away from zero as highway-env does."""
    if abs(value) > 1e-2:
        return value
    return 1e-2 if value >= 0.0 else -1e-2


@spliced
def clip(value, low, high):  # type: ignore[no-untyped-def]
    """Clip as NumPy does."""
    return min(max(value, low), high)


@part
def lane_coordinates(lanes: Floats, lane: int, x: float, y: float) -> tuple[float, float]:
    """Return the longitudinal and lateral coordinates (m) of a position on a lane."""
    east, south = x - lanes[lane, ORIGIN_X], y - lanes[lane, ORIGIN_Y]
    if lanes[lane, SHAPE] == CIRCULAR:
        turn, start, radius = lanes[lane, TURN], lanes[lane, START_PHASE], lanes[lane, RADIUS]
        phase = start + wrap_to_pi(math.atan2(south, east) - start)
        along = turn * (phase - start) * radius
        return along, turn * (radius - math.sqrt(east * east + south * south))
    along = east * lanes[lane, DIRECTION_X] + south * lanes[lane, DIRECTION_Y]
    beside = south * lanes[lane, DIRECTION_X] - east * lanes[lane, DIRECTION_Y]
    if lanes[lane, SHAPE] == SINE:
        swing = math.sin(lanes[lane, PULSATION] * along + lanes[lane, PHASE])
        beside -= lanes[lane, AMPLITUDE] * swing
    return along, beside


@part
def lane_heading(lanes: Floats, lane: int, along: float) -> float:
    """Return a lane's heading (rad) at a longitudinal coordinate (m)."""
    if lanes[lane, SHAPE] == STRAIGHT:
        return lanes[lane, LANE_HEADING]
    if lanes[lane, SHAPE] == CIRCULAR:
        turn = lanes[lane, TURN]
        phase = turn * along / lanes[lane, RADIUS] + lanes[lane, START_PHASE]
        return phase + math.pi / 2.0 * turn
    pulsation = lanes[lane, PULSATION]
    slope = lanes[lane, AMPLITUDE] * pulsation * math.cos(pulsation * along + lanes[lane, PHASE])
    return lanes[lane, LANE_HEADING] + math.atan(slope)


@part
def lane_centre(lanes: Floats, lane: int, along: float) -> tuple[float, float]:
    """Return the point (x, y in m) on a lane's centre line at a longitudinal coordinate (m)."""
    x, y = lanes[lane, ORIGIN_X], lanes[lane, ORIGIN_Y]
    if lanes[lane, SHAPE] == CIRCULAR:
        phase = lanes[lane, TURN] * along / lanes[lane, RADIUS] + lanes[lane, START_PHASE]
        radius = lanes[lane, RADIUS]
        return x + radius * math.cos(phase), y + radius * math.sin(phase)
    east, south = lanes[lane, DIRECTION_X], lanes[lane, DIRECTION_Y]
    x, y = x + along * east, y + along * south
    if lanes[lane, SHAPE] == SINE:
        swing = lanes[lane, AMPLITUDE] * math.sin(lanes[lane, PULSATION] * along + lanes[lane, PHASE])
        x, y = x - swing * south, y + swing * east
    return x, y


@part
def distance_to_lane(lanes: Floats, lane: int, x: float, y: float) -> float:
    """Return highway-env's distance (m) of a position from a lane: beside it plus before or after it."""
    along, beside = lane_coordinates(lanes, lane, x, y)
    return abs(beside) + max(along - lanes[lane, LANE_LENGTH], 0.0) + max(-along, 0.0)


@part
def is_reachable_from(lanes: Floats, lane: int, x: float, y: float) -> bool:
    """Return whether highway-env lets a vehicle change to a lane from a position."""
    if lanes[lane, FORBIDDEN] != 0.0:
        return False
    along, beside = lane_coordinates(lanes, lane, x, y)
    is_beside = abs(beside) <= 2.0 * lanes[lane, LANE_WIDTH]
    return is_beside and 0.0 <= along < lanes[lane, LANE_LENGTH] + lanes[lane, VEHICLE_LENGTH]


@spliced
def is_after_end(lanes, lane, along):  # type: ignore[no-untyped-def]
    """Return whether a longitudinal coordinate (m) is so near a lane's end that the next lane is followed."""
    return along > lanes[lane, LANE_LENGTH] - lanes[lane, VEHICLE_LENGTH] / 2.0


@part
def closest_lane(network: Network, x: float, y: float, heading: float, likely: int) -> int:
    """Return the closest lane to a pose (m, rad), of equal ones the first; `likely` is searched first."""
    lanes = network.lanes
    columns, rows = network.grid_shape[0], network.grid_shape[1]
    first, last = 0, len(lanes)
    in_grid = False
    column = (x - network.grid[0]) * network.grid[2]
    row = (y - network.grid[1]) * network.grid[2]
    if 0.0 <= column < columns and 0.0 <= row < rows:
        in_grid = True
        cell = int(row) * columns + int(column)
        first, last = network.cell_start[cell], network.cell_start[cell + 1]
    best_lane = likely
    best = _weighed_distance(lanes, likely, x, y, heading, math.inf)
    for index in range(first, last):
        lane = network.cell_lane[index] if in_grid else index
        if lane == likely:
            continue
        distance = _weighed_distance(lanes, lane, x, y, heading, best)
        if distance < best or (distance == best and lane < best_lane):
            best, best_lane = distance, lane
    return best_lane


@part
def _weighed_distance(lanes, lane, x, y, heading, limit):  # type: ignore[no-untyped-def]
    """Return the distance plus the angle between headings; a value above the limit may be inexact."""
    if lanes[lane, SHAPE] == CIRCULAR:
        east, south = x - lanes[lane, ORIGIN_X], y - lanes[lane, ORIGIN_Y]
        beside = abs(lanes[lane, RADIUS] - math.sqrt(east * east + south * south))
        if beside > limit:
            return beside
    along, beside = lane_coordinates(lanes, lane, x, y)
    distance = abs(beside) + max(along - lanes[lane, LANE_LENGTH], 0.0) + max(-along, 0.0)
    if distance > limit:
        return distance
    return distance + abs(wrap_to_pi(heading - lane_heading(lanes, lane, along)))
