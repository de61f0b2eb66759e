"""The town's surface on a fine grid, drawn once: coverage and height of each cell, by layers.

Where one road crosses over another, the one that is drawn first is in layer 0 and the other in layer 1 (and
so on), cell by cell, so that each can be looked up by its height.
"""

from __future__ import annotations

import math
import os
import weakref
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.errors import DrivingError
from athrl_driving.kernels.compilation import compiled
from athrl_driving.maps import LaneGraph, Town
from athrl_driving.maps.geometry import lane_pose, lane_project
from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.maps.opendrive.bounds import LARGEST_HEIGHT_RANGE

CELL = 0.5
"""Side of a cell of the town's grid, m."""

TILE = 32
"""Cells along the side of a tile, of which the least and the greatest height are stored."""

HEIGHT_UNIT = 0.1
"""Unit of a cell's height, m."""

_SAMPLES = 3
"""A cell has this many by this many sample points; its brightness is the share of them that lie on a lane."""

_MARGIN = 40.0
"""Width of the grid's empty border, m, for windows that reach beyond the roads."""

_JOINT = 0.25
"""Metres by which a lane is drawn beyond its ends, so that there is no gap between two lanes."""

_SEGMENT_LENGTH = 16.0
"""Length of a lane that is drawn at a time, m: the box around a longer part would be mostly empty."""

_LAYERS = 4

_HIGHEST = 0.5 * LARGEST_HEIGHT_RANGE
"""Metres above or below a base that cells can have; beyond, 16 bits of `HEIGHT_UNIT` would not do."""

_BYTES_OF_A_CELL = 11
"""Memory that drawing takes, at the least."""


class DrivableMap(NamedTuple):
    """A town's grid; rows lie along y, columns along x."""

    cells: NDArray[np.uint8]
    """[layers, rows, columns] share of the cell that is drivable; 255 is all of it."""
    height: NDArray[np.int16]
    """[layers, rows, columns] in HEIGHT_UNIT above `base`; undefined where nothing is drivable."""
    lowest: NDArray[np.float64]
    """[tile rows, tile columns] m; infinite where the tile is empty."""
    highest: NDArray[np.float64]
    """[tile rows, tile columns] m; minus infinity where the tile is empty."""
    left: float
    """x of the grid's first column's edge, m."""
    top: float
    """y of the grid's first row's edge, m."""
    base: float
    """m; 0 unless the map lies very high or low."""


_MAPS: dict[int, DrivableMap] = {}


def drivable_grid(town: Town) -> DrivableMap:
    """Return the grid of a town, which is drawn once.

    Raises `DrivingError` as `draw_drivable_map` does; it names the town.
    """
    if id(town) not in _MAPS:
        try:
            _MAPS[id(town)] = draw_drivable_map(town.graph)
        except DrivingError as error:
            raise DrivingError(f"{town.name}: {error}") from None
        weakref.finalize(town, _MAPS.pop, id(town), None)
    return _MAPS[id(town)]


def draw_drivable_map(graph: LaneGraph) -> DrivableMap:
    """Draw the lanes of a graph on a grid.

    Raises `DrivingError` in one line where they lie too far apart, in the plane or in height.
    """
    left, top = graph.box[:, :2].min(axis=0) - _MARGIN
    right, bottom = graph.box[:, 2:].max(axis=0) + _MARGIN
    rows, columns = math.ceil((bottom - top) / CELL), math.ceil((right - left) / CELL)
    _refuse_large(rows, columns)
    base = _base_of(graph)
    samples = np.zeros((_LAYERS, rows, columns), dtype=np.uint16)
    height = np.zeros((_LAYERS, rows, columns), dtype=np.int16)
    _draw_lanes(graph, left, top, base, samples, height)
    layers = max(1, int(np.count_nonzero(samples.any(axis=(1, 2)))))
    cells = _COVERAGE[samples[:layers]]
    lowest, highest = _heights_of_tiles(cells, height[:layers])
    lowest, highest = lowest + base, highest + base
    return DrivableMap(cells, height[:layers].copy(), lowest, highest, float(left), float(top), base)


def _refuse_large(rows: int, columns: int) -> None:
    """Raise `DrivingError` where the grid would not fit into the machine's memory."""
    needed, there_is = rows * columns * _BYTES_OF_A_CELL, _memory()
    if needed > there_is:
        width, height = columns * CELL / 1000.0, rows * CELL / 1000.0
        raise DrivingError(
            f"the map's lanes lie on {width:,.0f} x {height:,.0f} km: the picture of their surface takes "
            f"{needed / 2**30:,.0f} GiB, this machine has {there_is / 2**30:,.0f} GiB"
        )


def _memory() -> int:
    """Return the bytes of the machine's memory."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _base_of(graph: LaneGraph) -> float:
    """Return the height (m) from which those of cells count; raises `DrivingError`: they differ too much."""
    ends = np.concatenate([graph.elevation, graph.elevation + graph.grade * graph.length])
    low, high = float(ends.min()), float(ends.max())
    if low >= -_HIGHEST and high <= _HIGHEST:
        return 0.0
    if high - low > 2.0 * _HIGHEST:
        most = f"at most {2.0 * _HIGHEST:,.0f} m may be between them"
        raise DrivingError(f"the map's lanes lie from {low:,.0f} to {high:,.0f} m high, {most}")
    return float(round(0.5 * (low + high)))


_COVERAGE = np.array(
    [round(255 * number.bit_count() / _SAMPLES**2) for number in range(1 << _SAMPLES**2)], dtype=np.uint8
)
"""Brightness of a cell by the bit pattern of its sample points on a lane."""


def _heights_of_tiles(
    cells: NDArray[np.uint8], height: NDArray[np.int16]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the greatest height of the drivable cells in each tile, m."""
    shape = tuple(math.ceil(size / TILE) for size in cells.shape[1:])
    lowest, highest = np.full(shape, np.inf), np.full(shape, -np.inf)
    for row, column in np.ndindex(*shape):
        tile = np.s_[:, row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE]
        heights = height[tile][cells[tile] > 0]
        if heights.size:
            lowest[row, column] = heights.min() * HEIGHT_UNIT
            highest[row, column] = heights.max() * HEIGHT_UNIT
    return lowest, highest


@compiled
def _draw_lanes(
    graph: LaneGraph,
    left: float,
    top: float,
    base: float,
    samples: NDArray[np.uint16],
    height: NDArray[np.int16],
) -> None:
    """Set the bits of the sample points that lie on a lane, and the heights of their cells."""
    for lane in range(graph.length.size):
        start = -_JOINT
        while start < graph.length[lane] + _JOINT:
            end = min(start + _SEGMENT_LENGTH, graph.length[lane] + _JOINT)
            _draw_segment(graph, lane, start, end, left, top, base, samples, height)
            start = end


@compiled
def _draw_segment(
    graph: LaneGraph,
    lane: int,
    start: float,
    end: float,
    left: float,
    top: float,
    base: float,
    samples: NDArray[np.uint16],
    height: NDArray[np.int16],
) -> None:
    """Draw a lane from `start` to `end`, m along it."""
    x, y, _ = lane_pose(graph, lane, start)
    end_x, end_y, _ = lane_pose(graph, lane, end)
    # An arc bulges beyond its chord by up to length^2 * curvature / 8.
    reach = 0.5 * graph.width[lane] + abs(graph.curvature[lane]) * (end - start) ** 2 / 8.0
    step = CELL / _SAMPLES
    first_column = int((min(x, end_x) - reach - left) / step)
    last_column = int((max(x, end_x) + reach - left) / step)
    first_row = int((min(y, end_y) - reach - top) / step)
    last_row = int((max(y, end_y) + reach - top) / step)
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            along, across = lane_project(graph, lane, left + (column + 0.5) * step, top + (row + 0.5) * step)
            if abs(across) > 0.5 * graph.width[lane] or along < start or along > end:
                continue
            here = graph.elevation[lane] + graph.grade[lane] * along
            i, j = row // _SAMPLES, column // _SAMPLES
            bit = np.uint16(1 << ((row % _SAMPLES) * _SAMPLES + column % _SAMPLES))
            for layer in range(samples.shape[0]):
                if samples[layer, i, j] == 0:
                    height[layer, i, j] = np.int16(round((here - base) / HEIGHT_UNIT))
                elif abs(height[layer, i, j] * HEIGHT_UNIT + base - here) > ROAD_LEVEL_HEIGHT:
                    continue
                samples[layer, i, j] |= bit
                break
