"""Bounding boxes of lanes, and a grid of cells with the lanes in each."""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.lane_graph import GRID_CELL, Floats, Integers
from athrl_driving.maps.opendrive.bounds import LARGEST_AREA, MOST_GRID_ENTRIES

_SAMPLES = 17


class Grid(TypedDict):
    """The grid's fields of a `LaneGraph`."""

    grid_origin: Floats
    grid_shape: Integers
    grid_start: Integers
    grid_lane: Integers


def lane_boxes(
    x: Floats, y: Floats, heading: Floats, curvature: Floats, length: Floats, width: Floats
) -> Floats:
    """Return least x, least y, greatest x, greatest y (m) of the lanes' surfaces, [L, 4]."""
    s = length[:, None] * np.linspace(0.0, 1.0, _SAMPLES)
    # The chord of an arc: its length is s * sinc(half the turn), its direction half the turn.
    half = 0.5 * curvature[:, None] * s
    chord = s * np.sinc(half / np.pi)
    points_x = x[:, None] + chord * np.cos(heading[:, None] + half)
    points_y = y[:, None] + chord * np.sin(heading[:, None] + half)
    # Between two samples an arc bulges by up to (step/2)^2 / (2 radius).
    margin = 0.5 * width + np.abs(curvature) * (length / (_SAMPLES - 1)) ** 2 / 8.0
    return np.stack(
        [
            points_x.min(axis=1) - margin,
            points_y.min(axis=1) - margin,
            points_x.max(axis=1) + margin,
            points_y.max(axis=1) + margin,
        ],
        axis=1,
    )


def lane_grid(box: Floats) -> Grid:
    """Return the lanes whose boxes touch each cell, cells row by row. Raises `ValueError`: too large."""
    origin = box[:, :2].min(axis=0)
    width, height = (box[:, 2:].max(axis=0) - origin) / 1000.0
    if not width * height <= LARGEST_AREA:
        raise ValueError(
            f"the lanes lie on {width:,.0f} x {height:,.0f} km, at most {LARGEST_AREA:,.0f} km2 are allowed"
        )
    low = ((box[:, :2] - origin) // GRID_CELL).astype(np.int64)
    high = ((box[:, 2:] - origin) // GRID_CELL).astype(np.int64)
    shape = high.max(axis=0) + 1
    span = high - low + 1
    count = span.prod(axis=1)
    if count.sum() > MOST_GRID_ENTRIES:
        raise ValueError(f"its lanes are too long and too many: they touch {count.sum():,} cells of the grid")
    lane = np.repeat(np.arange(len(box)), count)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    column = low[lane, 0] + place % span[lane, 0]
    row = low[lane, 1] + place // span[lane, 0]
    cell = row * shape[0] + column
    order = np.argsort(cell, kind="stable")
    starts: NDArray[np.int64] = np.searchsorted(cell[order], np.arange(shape.prod() + 1)).astype(np.int64)
    return Grid(grid_origin=origin, grid_shape=shape, grid_start=starts, grid_lane=lane[order])
