"""nuPlan's comfort bounds on smoothed motion.

As in nuPlan, the motion is smoothed by fitting parabolas (a Savitzky-Golay filter): turning and jerk come
from the parabola through the 15 ticks around a moment. An episode's first and last seven ticks are taken from
its first and its last parabola; a shorter episode is one parabola. The turning rate is the slope of the
heading and the jerk that of the acceleration (`longitudinal_jerk`) or of its magnitude (`jerk`). Two things
differ: the accelerations themselves are smoothed over 7 ticks, not 8, so that the window has a middle, and
the yaw acceleration at the two ends is that of a parabola, not of a cubic.
"""

from __future__ import annotations

import math

from athrl_driving.kernels.compilation import inlined, inner
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.metrics.state import HEADING, LATERAL, LONGITUDINAL, MAGNITUDE, WINDOW

LEAST_LONGITUDINAL_ACCELERATION, GREATEST_LONGITUDINAL_ACCELERATION = -4.05, 2.40
"""m/s2"""
GREATEST_LATERAL_ACCELERATION = 4.89
"""m/s2, to either side."""
GREATEST_YAW_RATE = 0.95
"""rad/s, to either side."""
GREATEST_YAW_ACCELERATION = 1.93
"""rad/s2, either way."""
GREATEST_LONGITUDINAL_JERK = 4.13
"""m/s3, either way."""
GREATEST_JERK = 8.37
"""m/s3, either way."""

_ACCELERATION_WINDOW = 7


@inlined
def _parabola(window: Floats, column: int, first: int, count: int) -> tuple[float, float, float]:
    """Return value, slope and half the bend, per tick, at the middle of `count` values by least squares."""
    middle = 0.5 * (count - 1)
    total = by_place = by_square = squares = fourths = 0.0
    for index in range(count):
        place, value = index - middle, window[first + index, column]
        square = place * place
        total += value
        by_place += place * value
        by_square += square * value
        squares += square
        fourths += square * square
    slope = by_place / squares if squares > 0.0 else 0.0
    spread = count * fourths - squares * squares
    if spread < 1e-9:
        return total / count, slope, 0.0
    return (
        (fourths * total - squares * by_square) / spread,
        slope,
        (count * by_square - squares * total) / spread,
    )


@inlined
def _smoothed(window: Floats, column: int, first: int, count: int, place: int) -> float:
    """Return an acceleration at a place of the window, smoothed over the known ones around it."""
    width = min(_ACCELERATION_WINDOW, count)
    start = min(max(place - width // 2, first), first + count - width)
    value, slope, bend = _parabola(window, column, start, width)
    offset = place - start - 0.5 * (width - 1)
    return value + (slope + bend * offset) * offset


@inner
def judge(window: Floats, count: int, from_place: int, dt: float, comfortable: Integers) -> None:
    """Judge the ticks of the window from a place to the last or, in a long episode, to the middle.

    Adds 1 to each entry of `comfortable` [7] whose bound a tick keeps. The window's last `count` entries are
    known. A full window is judged up to its middle, or after it where `from_place` is after it.
    """
    first, last = WINDOW - count, WINDOW
    if count == WINDOW and from_place <= WINDOW // 2:
        last = WINDOW // 2 + 1
    _, turn, bend = _parabola(window, HEADING, first, count)
    _, jerk, jerk_bend = _parabola(window, LONGITUDINAL, first, count)
    _, whole_jerk, whole_bend = _parabola(window, MAGNITUDE, first, count)
    middle = first + 0.5 * (count - 1)
    for place in range(from_place, last):
        offset = 2.0 * (place - middle)
        longitudinal = _smoothed(window, LONGITUDINAL, first, count, place)
        lateral = _smoothed(window, LATERAL, first, count, place)
        kept = (
            LEAST_LONGITUDINAL_ACCELERATION <= longitudinal <= GREATEST_LONGITUDINAL_ACCELERATION,
            abs(lateral) <= GREATEST_LATERAL_ACCELERATION,
            abs(turn + bend * offset) <= GREATEST_YAW_RATE * dt,
            abs(2.0 * bend) <= GREATEST_YAW_ACCELERATION * dt * dt,
            abs(jerk + jerk_bend * offset) <= GREATEST_LONGITUDINAL_JERK * dt,
            abs(whole_jerk + whole_bend * offset) <= GREATEST_JERK * dt,
        )
        every = True
        for bound in range(6):
            comfortable[bound] += kept[bound]
            every &= kept[bound]
        comfortable[6] += every


@inlined
def remember(window: Floats, heading: float, longitudinal: float, lateral: float) -> None:
    """Shift the window by one tick and append the newest."""
    for place in range(WINDOW - 1):
        for column in range(4):
            window[place, column] = window[place + 1, column]
    window[WINDOW - 1, HEADING] = heading
    window[WINDOW - 1, LONGITUDINAL] = longitudinal
    window[WINDOW - 1, LATERAL] = lateral
    window[WINDOW - 1, MAGNITUDE] = math.hypot(longitudinal, lateral)
