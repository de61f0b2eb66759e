"""The window of the observation: a square around the ego, heading up.

Row 0 is furthest ahead, column 0 furthest left. The ego's frame has `forward` along its heading and `right`
to the driver's right, both in metres (y points down in highway-env, so right is the heading plus 90 degrees).
A pixel's centre is a whole number of rows and columns.
"""

from __future__ import annotations

from typing import NamedTuple

from athrl_driving.kernels.compilation import inlined

WINDOW_SIDE = 32.0
"""Default side of the window, m."""

EGO_ABOVE_LOWER_EDGE = 12.0
"""Default distance of the ego's centre from the window's lower edge, m."""


class Window(NamedTuple):
    """A window seen from a pose."""

    x: float
    """m, of the ego."""
    y: float
    """m."""
    cosine: float
    """Of the ego's heading."""
    sine: float
    pixel: float
    """A pixel's side, m."""
    ahead: float
    """m from the ego to the upper edge."""
    aside: float
    """m from the ego to the left and to the right edge."""


@inlined
def row_of(window: Window, forward: float) -> float:
    """Row of a distance ahead, m."""
    return (window.ahead - forward) / window.pixel - 0.5


@inlined
def column_of(window: Window, right: float) -> float:
    """Column of a distance to the right, m."""
    return (window.aside + right) / window.pixel - 0.5


@inlined
def forward_of(window: Window, row: float) -> float:
    """Metres ahead of the ego of a row's centre."""
    return window.ahead - (row + 0.5) * window.pixel


@inlined
def right_of(window: Window, column: float) -> float:
    """Metres to the ego's right of a column's centre."""
    return (column + 0.5) * window.pixel - window.aside


@inlined
def in_frame(window: Window, x: float, y: float) -> tuple[float, float]:
    """(forward, right) of a point in the world, m."""
    dx, dy = x - window.x, y - window.y
    return dx * window.cosine + dy * window.sine, dy * window.cosine - dx * window.sine
