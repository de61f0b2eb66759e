"""Channel 2, the ego's route: a soft line along the middle of its lanes, behind and ahead of the ego."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...compilation import compiled
from ...route.following import piece_pose
from ...route.state import LENGTH, START_POSITION
from .window import column_of, row_of

LINE_REACH = 1.5
"""Pixels from the line's middle to where its brightness has faded to nothing."""

LINE_STEP = 0.5
"""Distance between the points that the line is drawn through, pixels."""

LINE_BEHIND, LINE_AHEAD = 20.0, 36.0
"""Stretch of the route that can be inside the window, m; 36 m ahead leave it even on a bend."""


@compiled
def draw_route(
    image: NDArray[np.uint8],
    pixel: float,
    x: float,
    y: float,
    heading: float,
    pieces: NDArray[np.float64],
    count: int,
    position: float,
) -> None:
    """Draw the route on channel 2: 255 on its middle, falling linearly to 0 at LINE_REACH pixels from it."""
    cosine, sine = math.cos(heading), math.sin(heading)
    size = image.shape[0]
    index = 0
    distance = max(position - LINE_BEHIND, pieces[0, START_POSITION])
    end = min(position + LINE_AHEAD, pieces[count - 1, START_POSITION] + pieces[count - 1, LENGTH])
    while distance < end:
        while index + 1 < count and distance >= pieces[index + 1, START_POSITION]:
            index += 1
        point_x, point_y, _ = piece_pose(pieces, index, distance)
        distance += LINE_STEP * pixel
        dx, dy = point_x - x, point_y - y
        line_row = row_of(dx * cosine + dy * sine, pixel)
        line_column = column_of(dy * cosine - dx * sine, pixel)
        if not (-2.0 < line_row < size + 1.0 and -2.0 < line_column < size + 1.0):
            continue
        first_row, first_column = math.ceil(line_row - LINE_REACH), math.ceil(line_column - LINE_REACH)
        for row in range(max(first_row, 0), min(int(line_row + LINE_REACH) + 1, size)):
            for column in range(max(first_column, 0), min(int(line_column + LINE_REACH) + 1, size)):
                apart = math.sqrt((row - line_row) ** 2 + (column - line_column) ** 2)
                value = np.uint8(255.0 * max(1.0 - apart / LINE_REACH, 0.0) + 0.5)
                if value > image[row, column, 2]:
                    image[row, column, 2] = value
