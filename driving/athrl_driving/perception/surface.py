"""Channel 0, the drivable map: 255 where lanes are at the ego's height, 0 elsewhere, with soft edges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from athrl_driving.kernels.compilation import inlined, part
from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.perception.drivable import CELL, HEIGHT_UNIT, TILE, DrivableMap
from athrl_driving.perception.window import Window

_FINE = 65536.0


@inlined
def draw_surface(image: NDArray[np.uint8], window: Window, drivable: DrivableMap, elevation: float) -> None:
    """Fill channel 0 of `image` [size, size, 4] from the grid, smooth between cells; clear the rest."""
    # The grid's row and column at the image's first pixel. The next row of the image is a step backwards
    # along the heading, the next column a step to the right.
    forward, right = window.ahead - 0.5 * window.pixel, 0.5 * window.pixel - window.aside
    x = window.x + forward * window.cosine - right * window.sine
    y = window.y + forward * window.sine + right * window.cosine
    row, column = (y - drivable.top) / CELL - 0.5, (x - drivable.left) / CELL - 0.5
    along, across = window.pixel / CELL * window.cosine, window.pixel / CELL * window.sine
    if _is_level(window, drivable, elevation) and _is_inside(drivable, row, column, along, across, image):
        _sample_level(image, drivable.cells[0], row, column, along, across)
    else:
        _sample_layers(image, drivable, elevation, row, column, along, across)


@inlined
def _is_inside(
    drivable: DrivableMap,
    row: float,
    column: float,
    along: float,
    across: float,
    image: NDArray[np.uint8],
) -> bool:
    """Tell whether all pixels lie within the grid, from its row and column at the four corners."""
    last = image.shape[0] - 1
    lowest_row = row + last * (min(along, 0.0) - max(across, 0.0))
    highest_row = row + last * (max(along, 0.0) - min(across, 0.0))
    lowest_column = column - last * (max(along, 0.0) + max(across, 0.0))
    highest_column = column - last * (min(along, 0.0) + min(across, 0.0))
    return (
        lowest_row >= 1.0
        and lowest_column >= 1.0
        and highest_row < drivable.cells.shape[1] - 2
        and highest_column < drivable.cells.shape[2] - 2
    )


@inlined
def _is_level(window: Window, drivable: DrivableMap, elevation: float) -> bool:
    """Tell whether all drivable cells around the window are at the ego's height."""
    reach = math.hypot(max(window.ahead, 2.0 * window.aside - window.ahead), window.aside)
    rows, columns = drivable.lowest.shape
    side = TILE * CELL
    first_row = max(int((window.y - reach - drivable.top) / side), 0)
    last_row = min(int((window.y + reach - drivable.top) / side), rows - 1)
    first_column = max(int((window.x - reach - drivable.left) / side), 0)
    last_column = min(int((window.x + reach - drivable.left) / side), columns - 1)
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            if drivable.lowest[row, column] < elevation - ROAD_LEVEL_HEIGHT:
                return False
            if drivable.highest[row, column] > elevation + ROAD_LEVEL_HEIGHT:
                return False
    return True


@part
def _sample_level(
    image: NDArray[np.uint8],
    cells: NDArray[np.uint8],
    row: float,
    column: float,
    along: float,
    across: float,
) -> None:
    """Sample where there is one level only, in layer 0; all in whole numbers of 1/65536 cells."""
    start_row, start_column = int(row * _FINE), int(column * _FINE)
    step_along, step_across = int(along * _FINE), int(across * _FINE)
    for i in range(image.shape[0]):
        grid_row, grid_column = start_row - i * step_across, start_column - i * step_along
        for j in range(image.shape[1]):
            # Unsigned, because numba checks the sign of a signed index.
            upper, left = np.uint64(grid_row >> 16), np.uint64(grid_column >> 16)
            lower, right = upper + np.uint64(1), left + np.uint64(1)
            down, aside = (grid_row >> 8) & 255, (grid_column >> 8) & 255
            above = np.int64(cells[upper, left]) * (256 - aside) + np.int64(cells[upper, right]) * aside
            below = np.int64(cells[lower, left]) * (256 - aside) + np.int64(cells[lower, right]) * aside
            image[i, j, 0] = (above * (256 - down) + below * down + 32768) >> 16
            image[i, j, 1] = image[i, j, 2] = image[i, j, 3] = 0
            grid_row += step_along
            grid_column -= step_across


@part
def _sample_layers(
    image: NDArray[np.uint8],
    drivable: DrivableMap,
    elevation: float,
    row: float,
    column: float,
    along: float,
    across: float,
) -> None:
    """Sample where several levels meet, or the grid ends: a cell counts in the layer at the ego's height."""
    _, rows, columns = drivable.cells.shape
    image[:] = 0
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            grid_row, grid_column = row - i * across + j * along, column - i * along - j * across
            upper, left = math.floor(grid_row), math.floor(grid_column)
            if upper < 0 or left < 0 or upper > rows - 2 or left > columns - 2:
                continue
            down, aside = grid_row - upper, grid_column - left
            above = (1.0 - aside) * _share(drivable, upper, left, elevation)
            above += aside * _share(drivable, upper, left + 1, elevation)
            below = (1.0 - aside) * _share(drivable, upper + 1, left, elevation)
            below += aside * _share(drivable, upper + 1, left + 1, elevation)
            image[i, j, 0] = int(above * (1.0 - down) + below * down + 0.5)


@inlined
def _share(drivable: DrivableMap, row: int, column: int, elevation: float) -> float:
    """Brightness of a cell at a height, m."""
    for layer in range(drivable.cells.shape[0]):
        share = drivable.cells[layer, row, column]
        if share == 0:
            return 0.0
        height = drivable.height[layer, row, column] * HEIGHT_UNIT + drivable.base
        if abs(height - elevation) <= ROAD_LEVEL_HEIGHT:
            return float(share)
    return 0.0
