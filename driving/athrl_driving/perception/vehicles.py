"""Channel 1, the other vehicles and their predicted positions.

A vehicle's body has 255. Ahead of it are the places where the body will be if the vehicle keeps its speed
and its yaw rate: every 0.25 s for two seconds, each darker than the one before, so the brightness of a pixel
tells how soon it may be occupied. A standing vehicle is only a body. A single image thus shows direction and
speed of the others, which a body alone does not; the ego itself is not drawn.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from athrl_driving.kernels.compilation import inlined, part
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.perception.window import Window, column_of, forward_of, in_frame, right_of, row_of
from athrl_driving.traffic.state import Background

PREDICTION_INTERVAL = 0.25
"""Time between the predicted positions, s."""

PREDICTION_STEPS = 8
"""Number of predicted positions that are drawn."""

PREDICTION_BRIGHTNESS = 176.0
"""Brightness of the first of them; the last has an eighth of it."""

STANDING_SPEED = 0.2
"""Below this speed (m/s) a vehicle counts as standing."""


@inlined
def draw_vehicles(
    image: NDArray[np.uint8],
    window: Window,
    heading: float,
    elevation: float,
    graph: LaneGraph,
    vehicles: Background,
) -> None:
    """Draw bodies and predicted positions on channel 1; the yaw rate is speed times lane curvature."""
    x, y, headings, heights = vehicles.x, vehicles.y, vehicles.heading, vehicles.elevation
    speeds, lengths, widths, lanes = vehicles.speed, vehicles.length, vehicles.width, vehicles.lane
    curvature = graph.curvature
    behind = 2.0 * window.aside - window.ahead
    for vehicle in range(x.shape[0]):
        forward, right = in_frame(window, x[vehicle], y[vehicle])
        speed = speeds[vehicle]
        reach = abs(speed) * PREDICTION_INTERVAL * PREDICTION_STEPS + lengths[vehicle]
        if abs(right) > window.aside + reach or forward > window.ahead + reach or forward < -behind - reach:
            continue
        if abs(heights[vehicle] - elevation) > ROAD_LEVEL_HEIGHT:
            continue
        angle = headings[vehicle] - heading
        half_length, half_width = 0.5 * lengths[vehicle], 0.5 * widths[vehicle]
        turning = speed * curvature[lanes[vehicle]]
        brightness = 255.0
        for step in range(PREDICTION_STEPS + 1):
            draw_body(image, window, forward, right, angle, half_length, half_width, brightness)
            if abs(speed) < STANDING_SPEED:
                break
            # The chord of the arc driven in one step lies along the mean of its two headings.
            middle = angle + 0.5 * turning * PREDICTION_INTERVAL
            forward += speed * PREDICTION_INTERVAL * math.cos(middle)
            right += speed * PREDICTION_INTERVAL * math.sin(middle)
            angle += turning * PREDICTION_INTERVAL
            brightness = PREDICTION_BRIGHTNESS * (PREDICTION_STEPS - step) / PREDICTION_STEPS


@part
def draw_body(
    image: NDArray[np.uint8],
    window: Window,
    forward: float,
    right: float,
    heading: float,
    half_length: float,
    half_width: float,
    brightness: float,
) -> None:
    """Draw a rectangle given in the ego's frame; edges are anti-aliased, brighter pixels stay."""
    cosine, sine = math.cos(heading), math.sin(heading)
    pixel = window.pixel
    # The soft edge reaches half a pixel beyond each side.
    outer_length, outer_width = half_length + 0.5 * pixel, half_width + 0.5 * pixel
    reach_forward = abs(outer_length * cosine) + abs(outer_width * sine)
    reach_right = abs(outer_length * sine) + abs(outer_width * cosine)
    first_row = max(0, math.ceil(row_of(window, forward + reach_forward)))
    last_row = min(image.shape[0] - 1, math.floor(row_of(window, forward - reach_forward)))
    first_column = max(0, math.ceil(column_of(window, right - reach_right)))
    last_column = min(image.shape[1] - 1, math.floor(column_of(window, right + reach_right)))
    # In pixels, so that differences are the covered share of a pixel.
    length, width = outer_length / pixel, outer_width / pixel
    along_step, across_step = cosine / pixel, sine / pixel
    for row in range(first_row, last_row + 1):
        ahead = forward_of(window, row) - forward
        for column in range(first_column, last_column + 1):
            aside = right_of(window, column) - right
            along = min(length - abs(ahead * along_step + aside * across_step), 1.0)
            across = min(width - abs(aside * along_step - ahead * across_step), 1.0)
            if along <= 0.0 or across <= 0.0:
                continue
            value = int(brightness * along * across + 0.5)
            if value > image[row, column, 1]:
                image[row, column, 1] = value
