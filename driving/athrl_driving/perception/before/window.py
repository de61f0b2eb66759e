"""The window of the observation: a square around the ego, heading up.

Row 0 is furthest ahead, column 0 furthest left. The ego's frame has `forward` along its heading and `right`
to the driver's right, both in metres (y points down in highway-env, so right is the heading plus 90 degrees).
"""

from __future__ import annotations

from ...compilation import inlined

WINDOW_SIDE = 32.0
"""Side of the window, m."""

EGO_ABOVE_LOWER_EDGE = 12.0
"""Distance of the ego's centre from the window's lower edge, m."""


@inlined
def row_of(forward: float, pixel: float) -> float:
    """Row (a pixel's centre is a whole number) of a distance ahead; `pixel` is a pixel's side in metres."""
    return (WINDOW_SIDE - EGO_ABOVE_LOWER_EDGE - forward) / pixel - 0.5


@inlined
def column_of(right: float, pixel: float) -> float:
    """Column (a pixel's centre is a whole number) of a distance to the right."""
    return (WINDOW_SIDE / 2 + right) / pixel - 0.5


@inlined
def forward_of(row: float, pixel: float) -> float:
    """Metres ahead of the ego of a row's centre."""
    return WINDOW_SIDE - EGO_ABOVE_LOWER_EDGE - (row + 0.5) * pixel


@inlined
def right_of(column: float, pixel: float) -> float:
    """Metres to the ego's right of a column's centre."""
    return (column + 0.5) * pixel - WINDOW_SIDE / 2
