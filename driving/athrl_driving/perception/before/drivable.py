"""Channel 0, the drivable map: 255 where lanes are, 0 elsewhere, the edges anti-aliased.

The town is drawn once on a fine grid, and each observation samples the grid in the turned window: the cost
does not depend on the number of lanes.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...compilation import compiled
from ...maps import LaneGraph, load_town
from ...maps.geometry import lane_project
from .window import forward_of, right_of

CELL = 0.5
"""Side of a cell of the town's grid, m."""

_SAMPLES = 3
"""A cell's brightness is the share of this many by this many points in it that lie on a lane."""

_MARGIN = 8.0
"""Empty border of the grid, m; what lies beyond the grid is not drivable either."""

_JOINT = 0.25
"""Metres by which a lane is drawn beyond its ends, so that the seam of two lanes has no gap."""


@dataclass(frozen=True)
class DrivableMap:
    """A town's grid."""

    cells: NDArray[np.uint8]
    """[rows, columns] share of the cell that is drivable, of 255; rows along y, columns along x."""
    left: float
    """x of the grid's first column's edge, m."""
    top: float
    """y of the grid's first row's edge, m."""


@functools.cache
def drivable_map(town: str) -> DrivableMap:
    """Grid of a town, drawn once in a process."""
    return draw_drivable_map(load_town(town).graph)


def draw_drivable_map(graph: LaneGraph) -> DrivableMap:
    """Draw the lanes of a graph on a grid."""
    left, top = graph.box[:, :2].min(axis=0) - _MARGIN
    right, bottom = graph.box[:, 2:].max(axis=0) + _MARGIN
    shape = (math.ceil((bottom - top) / CELL), math.ceil((right - left) / CELL))
    samples = np.zeros((shape[0] * _SAMPLES, shape[1] * _SAMPLES), dtype=np.bool_)
    _draw_lanes(graph, left, top, samples)
    share = samples.reshape(shape[0], _SAMPLES, shape[1], _SAMPLES).mean(axis=(1, 3), dtype=np.float32)
    return DrivableMap(np.round(share * 255).astype(np.uint8), float(left), float(top))


@compiled
def _draw_lanes(graph: LaneGraph, left: float, top: float, samples: NDArray[np.bool_]) -> None:
    """Set the sample points that lie on a lane."""
    step = CELL / _SAMPLES
    for lane in range(graph.length.size):
        first_column = int((graph.box[lane, 0] - left - _JOINT) / step)
        last_column = int((graph.box[lane, 2] - left + _JOINT) / step)
        first_row = int((graph.box[lane, 1] - top - _JOINT) / step)
        last_row = int((graph.box[lane, 3] - top + _JOINT) / step)
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                if samples[row, column]:
                    continue
                x, y = left + (column + 0.5) * step, top + (row + 0.5) * step
                along, across = lane_project(graph, lane, x, y)
                samples[row, column] = (
                    abs(across) <= graph.width[lane] / 2 and -_JOINT <= along <= graph.length[lane] + _JOINT
                )


@compiled
def sample_drivable_map(
    image: NDArray[np.uint8],
    cells: NDArray[np.uint8],
    left: float,
    top: float,
    pixel: float,
    x: float,
    y: float,
    heading: float,
) -> None:
    """Fill channel 0 of `image` [size, size, 4] from the grid, interpolating between cells."""
    cosine, sine = math.cos(heading), math.sin(heading)
    last_row, last_column = cells.shape[0] - 2, cells.shape[1] - 2
    for row in range(image.shape[0]):
        forward = forward_of(row, pixel)
        for column in range(image.shape[1]):
            right = right_of(column, pixel)
            grid_column = (x + forward * cosine - right * sine - left) / CELL - 0.5
            grid_row = (y + forward * sine + right * cosine - top) / CELL - 0.5
            i, j = math.floor(grid_row), math.floor(grid_column)
            if i < 0 or j < 0 or i > last_row or j > last_column:
                image[row, column, 0] = 0
                continue
            down, along = grid_row - i, grid_column - j
            upper = cells[i, j] * (1 - along) + cells[i, j + 1] * along
            lower = cells[i + 1, j] * (1 - along) + cells[i + 1, j + 1] * along
            image[row, column, 0] = np.uint8(upper * (1 - down) + lower * down + 0.5)
