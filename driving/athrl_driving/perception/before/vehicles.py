"""Channel 1, the other vehicles and where they are about to be.

A vehicle's body has 255. Ahead of it lie the places where the body will be if the vehicle keeps its speed
and its rate of turning: every 0.25 s for two seconds, darker with each, so the brightness of a pixel tells
how soon it may be taken. A standing vehicle is a bare body. Direction and speed of the others are thus in a
single image, which a body alone does not show; the ego itself is not drawn.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...compilation import compiled
from .window import EGO_ABOVE_LOWER_EDGE, WINDOW_SIDE, column_of, forward_of, right_of, row_of

FORESIGHT_INTERVAL = 0.25
"""Time between the drawn places, s."""

FORESIGHT_STEPS = 8
"""Places ahead that are drawn."""

FORESIGHT_BRIGHTNESS = 176.0
"""Brightness of the first of them; the last has an eighth of it."""

STANDING_SPEED = 0.2
"""Below this speed (m/s) a vehicle counts as standing."""


@compiled
def draw_body(
    image: NDArray[np.uint8],
    channel: int,
    pixel: float,
    forward: float,
    right: float,
    heading: float,
    half_length: float,
    half_width: float,
    brightness: float,
) -> None:
    """Draw a rectangle given in the ego's frame; edges are anti-aliased, brighter pixels stay."""
    cosine, sine = math.cos(heading), math.sin(heading)
    reach_forward = abs(half_length * cosine) + abs(half_width * sine) + pixel
    reach_right = abs(half_length * sine) + abs(half_width * cosine) + pixel
    first_row = max(0, math.floor(row_of(forward + reach_forward, pixel)))
    last_row = min(image.shape[0] - 1, math.ceil(row_of(forward - reach_forward, pixel)))
    first_column = max(0, math.floor(column_of(right - reach_right, pixel)))
    last_column = min(image.shape[1] - 1, math.ceil(column_of(right + reach_right, pixel)))
    for row in range(first_row, last_row + 1):
        ahead = forward_of(row, pixel) - forward
        for column in range(first_column, last_column + 1):
            aside = right_of(column, pixel) - right
            along = abs(ahead * cosine + aside * sine)
            across = abs(aside * cosine - ahead * sine)
            covered_along = min(max((half_length - along) / pixel + 0.5, 0.0), 1.0)
            covered_across = min(max((half_width - across) / pixel + 0.5, 0.0), 1.0)
            value = np.uint8(brightness * covered_along * covered_across + 0.5)
            if value > image[row, column, channel]:
                image[row, column, channel] = value


@compiled
def draw_vehicles(
    image: NDArray[np.uint8],
    pixel: float,
    ego_x: float,
    ego_y: float,
    ego_heading: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    heading: NDArray[np.float64],
    speed: NDArray[np.float64],
    turning: NDArray[np.float64],
    length: NDArray[np.float64],
    width: NDArray[np.float64],
) -> None:
    """Draw bodies and foresight of all vehicles on channel 1; `turning` is the heading's rate, rad/s."""
    cosine, sine = math.cos(ego_heading), math.sin(ego_heading)
    for vehicle in range(x.size):
        dx, dy = x[vehicle] - ego_x, y[vehicle] - ego_y
        forward, right = dx * cosine + dy * sine, dy * cosine - dx * sine
        travel = abs(speed[vehicle]) * FORESIGHT_INTERVAL * FORESIGHT_STEPS
        reach = travel + length[vehicle]
        if (
            abs(right) > WINDOW_SIDE / 2 + reach
            or forward > WINDOW_SIDE - EGO_ABOVE_LOWER_EDGE + reach
            or forward < -EGO_ABOVE_LOWER_EDGE - reach
        ):
            continue
        angle = heading[vehicle] - ego_heading
        half_length, half_width = length[vehicle] / 2, width[vehicle] / 2
        draw_body(image, 1, pixel, forward, right, angle, half_length, half_width, 255.0)
        if abs(speed[vehicle]) < STANDING_SPEED:
            continue
        for step in range(1, FORESIGHT_STEPS + 1):
            # The chord of the arc driven in one step lies along the mean of its two headings.
            middle = angle + 0.5 * turning[vehicle] * FORESIGHT_INTERVAL
            forward += speed[vehicle] * FORESIGHT_INTERVAL * math.cos(middle)
            right += speed[vehicle] * FORESIGHT_INTERVAL * math.sin(middle)
            angle += turning[vehicle] * FORESIGHT_INTERVAL
            brightness = FORESIGHT_BRIGHTNESS * (FORESIGHT_STEPS + 1 - step) / FORESIGHT_STEPS
            draw_body(image, 1, pixel, forward, right, angle, half_length, half_width, brightness)
