"""Channel 2, the ego's route: a soft line along it, behind and ahead of the ego.

Beyond a stop line whose light is not green the line has half its brightness.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from athrl_driving.kernels.compilation import inlined, part
from athrl_driving.maps.lane_graph import Signals
from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.perception.window import Window, column_of, in_frame, row_of
from athrl_driving.route.state import CURVATURE, LENGTH, START_POSITION, RouteState
from athrl_driving.route.tracking import KEPT_BEHIND, KNOWN_AT_LEAST, segment_pose
from athrl_driving.traffic.state import Traffic

LINE_REACH = 1.5
"""Pixels from the line's middle to where its brightness has faded to 0."""

STOPPED_BRIGHTNESS = 0.5
"""Share of its brightness that the line keeps beyond a light that is not green."""

_STEP = 1.0
"""Length of the straight steps that the line is drawn with, pixels."""


@inlined
def draw_route(
    image: NDArray[np.uint8], window: Window, elevation: float, traffic: Traffic, route: RouteState
) -> None:
    """Draw the route on channel 2: 255 on its middle, falling linearly to 0 at LINE_REACH pixels from it."""
    elevations, grades = traffic.graph.elevation, traffic.graph.grade
    segments, lanes, lane_starts = route.segments, route.lane, route.lane_start
    behind = 2.0 * window.aside - window.ahead
    # The part of the route that can be inside the window, even on a bend, as far as it is always known.
    first = route.position[0] - min(1.25 * math.hypot(behind, window.aside), KEPT_BEHIND)
    last = route.position[0] + min(1.5 * math.hypot(window.ahead, window.aside), KNOWN_AT_LEAST)
    stop = _stop_position(traffic, route)
    for index in range(route.segment_count[0]):
        start = segments[index, START_POSITION]
        if start >= last:
            break
        grade = grades[lanes[index]]
        above = elevations[lanes[index]] + grade * lane_starts[index] - elevation
        low, high = _on_the_level(above, grade)
        begin = max(start + low, start, first)
        end = min(start + high, start + segments[index, LENGTH], last)
        if begin < end:
            _draw_segment(image, window, segments, index, begin, end, stop)


@inlined
def _on_the_level(above: float, grade: float) -> tuple[float, float]:
    """Return from and up to which m along a slope it is about as high as the ego, infinite where it is level.

    It starts `above` m above the ego. Where it is nowhere as high, the end is before the start.
    """
    if grade == 0.0:
        return (-math.inf, math.inf) if abs(above) <= ROAD_LEVEL_HEIGHT else (math.inf, -math.inf)
    low, high = (-ROAD_LEVEL_HEIGHT - above) / grade, (ROAD_LEVEL_HEIGHT - above) / grade
    return min(low, high), max(low, high)


@inlined
def _stop_position(traffic: Traffic, route: RouteState) -> float:
    """Return the position along the route of the first light ahead that is not green, m; infinite if none.

    The movement through a junction that the ego is already on does not count.
    """
    if traffic.signals.cycle.shape[0] == 0:
        return math.inf
    movement_of = traffic.graph.movement
    present = movement_of[route.lane[route.ego_segment[0]]]
    for index in range(route.ego_segment[0] + 1, route.segment_count[0]):
        movement = movement_of[route.lane[index]]
        if movement >= 0 and movement != present:
            if not _is_green(traffic.signals, traffic.movements.signal[movement], traffic.scratch.clock[0]):
                return route.segments[index, START_POSITION]
            present = movement
    return math.inf


@inlined
def _is_green(signals: Signals, group: int, clock: float) -> bool:
    """Tell whether a group of lights (-1: there is none) is green at a time, s."""
    if group < 0:
        return True
    cycle = signals.cycle[group]
    since = (clock - signals.green_from[group]) % cycle
    return since < (signals.green_until[group] - signals.green_from[group]) % cycle


@part
def _draw_segment(
    image: NDArray[np.uint8],
    window: Window,
    segments: NDArray[np.float64],
    index: int,
    begin: float,
    end: float,
    stop: float,
) -> None:
    """Draw a segment from `begin` to `end` (m along the route) as straight steps about a pixel long."""
    straight = segments[index, CURVATURE] == 0.0
    steps = max(1, math.ceil((end - begin) / (_STEP * window.pixel)))
    length = (end - begin) / steps
    x, y, heading = segment_pose(segments, index, begin)
    forward, right = in_frame(window, x, y)
    line_row, line_column = row_of(window, forward), column_of(window, right)
    # `down` and `along` are the change of row and column over a step; on an arc they turn at each step.
    turn = segments[index, CURVATURE] * length
    cosine, sine = math.cos(heading + 0.5 * turn), math.sin(heading + 0.5 * turn)
    down = -(cosine * window.cosine + sine * window.sine)
    along = sine * window.cosine - cosine * window.sine
    turn_cosine, turn_sine = math.cos(turn), math.sin(turn)
    chord = length / window.pixel
    if not straight:
        chord *= math.sin(0.5 * turn) / (0.5 * turn)
    size = image.shape[0]
    for step in range(steps):
        next_row, next_column = line_row + down * chord, line_column + along * chord
        if -2.0 < line_row < size + 1.0 and -2.0 < line_column < size + 1.0:
            brightness = 255.0 if begin + step * length < stop else 255.0 * STOPPED_BRIGHTNESS
            _draw_step(image, line_row, line_column, next_row, next_column, down, along, chord, brightness)
        line_row, line_column = next_row, next_column
        if not straight:
            down, along = down * turn_cosine + along * turn_sine, along * turn_cosine - down * turn_sine


@inlined
def _draw_step(
    image: NDArray[np.uint8],
    row_from: float,
    column_from: float,
    row_to: float,
    column_to: float,
    down: float,
    along: float,
    length: float,
    brightness: float,
) -> None:
    """Draw a straight step of the line, all in pixels: each pixel by its distance from the step."""
    last = image.shape[0] - 1
    first_row = max(math.ceil(min(row_from, row_to) - LINE_REACH), 0)
    last_row = min(math.floor(max(row_from, row_to) + LINE_REACH), last)
    first_column = max(math.ceil(min(column_from, column_to) - LINE_REACH), 0)
    last_column = min(math.floor(max(column_from, column_to) + LINE_REACH), last)
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            row_off, column_off = row - row_from, column - column_from
            driven = min(max(row_off * down + column_off * along, 0.0), length)
            row_off -= driven * down
            column_off -= driven * along
            square = row_off * row_off + column_off * column_off
            if square < LINE_REACH * LINE_REACH:
                value = int(brightness * (1.0 - math.sqrt(square) / LINE_REACH) + 0.5)
                if value > image[row, column, 2]:
                    image[row, column, 2] = value
