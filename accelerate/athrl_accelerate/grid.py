"""A grid of cells, each with the lanes that can be the closest one somewhere in it; exact, no approximation.

highway-env's distance to a lane is how far a position is beside it, plus how far it is before or behind it,
plus the angle between both headings. In a cell the first two are bounded from below and above; a lane whose
lower bound exceeds another lane's upper bound by more than the greatest angle, pi, can never be the closest.
"""

import math

import numpy as np
from athrl_driving.kernels.compilation import entry, part, spliced
from numpy.typing import NDArray

from athrl_accelerate.columns import Floats, Integers
from athrl_accelerate.lanes import (
    AMPLITUDE,
    CIRCULAR,
    LANE_LENGTH,
    ORIGIN_X,
    ORIGIN_Y,
    PULSATION,
    RADIUS,
    SHAPE,
    SINE,
    START_PHASE,
    TURN,
    distance_to_lane,
    lane_centre,
    wrap_to_pi,
)

CELL = 4.0
"""m, a cell's side, unless there were more than `MOST_CELLS`."""
MOST_CELLS = 500_000
AROUND = 32.0
"""m around the lanes that the grid covers."""
BLOCK = 8
"""Side of a block of cells that share a first, coarse selection of lanes."""
FEW_LANES = 6
"""Up to this many lanes, all of them are searched."""
SLACK = 1e-6
"""m, for rounding."""


def closest_lane_grid(lanes: Floats) -> tuple[Floats, Integers, Integers, Integers]:
    """Return a `Network`'s grid, grid_shape, cell_start and cell_lane."""
    empty = np.zeros(0, np.int64)
    if len(lanes) <= FEW_LANES:
        return np.array([0.0, 0.0, 1.0]), np.zeros(2, np.int64), np.zeros(1, np.int64), empty
    low, high = _box(lanes)
    low, high = low - AROUND, high + AROUND
    cell = max(CELL, math.sqrt(float(np.prod(high - low)) / MOST_CELLS))
    blocks = np.ceil((high - low) / (cell * BLOCK)).astype(np.int64)
    shape = blocks * BLOCK
    start = np.zeros(int(shape[0] * shape[1]) + 1, np.int64)
    grid = np.array([low[0], low[1], 1.0 / cell])
    cell_lane = np.zeros(0, np.int64)
    room = np.empty(len(lanes)), np.empty((3, len(lanes)), np.int64)
    room[1][2] = np.arange(len(lanes))
    fill_grid(lanes, grid, shape, start, cell_lane, *room)
    np.cumsum(start, out=start)
    cell_lane = np.zeros(start[-1], np.int64)
    fill_grid(lanes, grid, shape, start, cell_lane, *room)
    return grid, shape, start, cell_lane


def _box(lanes: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = []
    for row in range(len(lanes)):
        for share in np.linspace(0.0, 1.0, 9):
            points.append(lane_point(lanes, row, share * lanes[row, LANE_LENGTH]))
    corners = np.array(points)
    return corners.min(axis=0), corners.max(axis=0)


@entry
def lane_point(lanes: Floats, lane: int, along: float) -> tuple[float, float]:
    """Return a point on a lane's centre line."""
    return lane_centre(lanes, lane, along)


@entry
def fill_grid(
    lanes: Floats,
    grid: Floats,
    shape: Integers,
    start: Integers,
    cell_lane: Integers,
    lower: Floats,
    chosen: Integers,
) -> None:
    """Count the lanes of every cell into `start`, or, where there is room for them, write them.

    `lower` [L] and `chosen` [3, L] are working memory; the last row of `chosen` lists all lanes.
    """
    side = 1.0 / grid[2]
    write = len(cell_lane) > 0
    coarse, fine, everything = chosen[0], chosen[1], chosen[2]
    half_block = side * BLOCK / 2.0
    for block_row in range(shape[1] // BLOCK):
        for block_column in range(shape[0] // BLOCK):
            x = grid[0] + (2 * block_column + 1) * half_block
            y = grid[1] + (2 * block_row + 1) * half_block
            candidates = _choose(lanes, everything, len(lanes), x, y, half_block, lower, coarse)
            for index in range(BLOCK * BLOCK):
                column = block_column * BLOCK + index % BLOCK
                row = block_row * BLOCK + index // BLOCK
                x, y = grid[0] + (column + 0.5) * side, grid[1] + (row + 0.5) * side
                count = _choose(lanes, coarse, candidates, x, y, side / 2.0, lower, fine)
                cell = row * shape[0] + column
                if not write:
                    start[cell + 1] = count
                    continue
                for place in range(count):
                    cell_lane[start[cell] + place] = fine[place]


@part
def _choose(lanes, among, count, x, y, half_side, lower, chosen):  # type: ignore[no-untyped-def]
    """Write the lanes that can be the closest in a square into `chosen`; return how many."""
    radius = half_side * math.sqrt(2.0)
    least = math.inf
    for index in range(count):
        lower[index], upper = _bounds(lanes, among[index], x, y, radius)
        least = min(least, upper)
    written = 0
    for index in range(count):
        if lower[index] <= least + math.pi + SLACK:
            chosen[written] = among[index]
            written += 1
    return written


@part
def _bounds(lanes, lane, x, y, radius):  # type: ignore[no-untyped-def]
    """Return the least and the greatest distance from a lane within `radius` of a point, or wider bounds."""
    if lanes[lane, SHAPE] != CIRCULAR:
        distance = distance_to_lane(lanes, lane, x, y)
        slope = 0.0
        if lanes[lane, SHAPE] == SINE:
            slope = abs(lanes[lane, AMPLITUDE] * lanes[lane, PULSATION])
        # Beside the lane it changes by 1 a metre across and by the slope along, before it by 1 along.
        change = math.sqrt(1.0 + (1.0 + slope) ** 2) * radius
        return distance - change, distance + change
    length, turn, arc = lanes[lane, LANE_LENGTH], lanes[lane, TURN], lanes[lane, RADIUS]
    east, south = x - lanes[lane, ORIGIN_X], y - lanes[lane, ORIGIN_Y]
    centre = math.sqrt(east * east + south * south)
    beside = abs(arc - centre)
    if centre > radius:
        middle = wrap_to_pi(math.atan2(south, east) - lanes[lane, START_PHASE])
        spread = math.asin(radius / centre) + 1e-9
        first, last = middle - spread, middle + spread
    else:
        first, last = -math.pi, math.pi
    least, most = _excess(first, min(last, math.pi), turn * arc, length)
    if first < -math.pi:
        least, most = _excess(-math.pi, min(last, math.pi), turn * arc, length)
        other_least, other_most = _excess(first + 2.0 * math.pi, math.pi, turn * arc, length)
        least, most = min(least, other_least), max(most, other_most)
    elif last > math.pi:
        other_least, other_most = _excess(-math.pi, last - 2.0 * math.pi, turn * arc, length)
        least, most = min(least, other_least), max(most, other_most)
    return max(beside - radius, 0.0) + least, beside + radius + most


@spliced
def _excess(first, last, scale, length):  # type: ignore[no-untyped-def]
    """Return the least and greatest distance before or behind a lane over an interval of phases."""
    low, high = min(first * scale, last * scale), max(first * scale, last * scale)
    return max(low - length, -high, 0.0), max(high - length, -low, 0.0)
