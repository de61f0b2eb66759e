"""Whether two vehicles touch: a separating-axis test with the results of highway-env's polygon test."""

import math

from athrl_driving.kernels.compilation import compiled
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.maps.levels import VEHICLE_LEVEL_HEIGHT
from athrl_driving.traffic.columns import NONE, Background
from athrl_driving.traffic.ego_columns import ELEVATION, HEADING, LENGTH, WIDTH, X, Y


@compiled
def rectangles_touch(
    x: float, y: float, heading: float, length: float, width: float,
    other_x: float, other_y: float, other_heading: float, other_length: float, other_width: float,
) -> bool:  # fmt: skip
    """Tell whether two rectangles share a point. Lengths in metres, headings in radians."""
    dx, dy = other_x - x, other_y - y
    reach = math.hypot(length, width) + math.hypot(other_length, other_width)
    if 4.0 * (dx * dx + dy * dy) > reach * reach:
        return False
    cos, sin = math.cos(heading), math.sin(heading)
    other_cos, other_sin = math.cos(other_heading), math.sin(other_heading)
    c, s = abs(cos * other_cos + sin * other_sin), abs(sin * other_cos - cos * other_sin)
    return (
        2.0 * abs(dx * cos + dy * sin) <= length + other_length * c + other_width * s
        and 2.0 * abs(dy * cos - dx * sin) <= width + other_length * s + other_width * c
        and 2.0 * abs(dx * other_cos + dy * other_sin) <= other_length + length * c + width * s
        and 2.0 * abs(dy * other_cos - dx * other_sin) <= other_width + length * s + width * c
    )


@compiled
def first_touched(background: Background, ego: Floats) -> int:
    """Return the first vehicle of an environment's view that the ego (`ego_columns`) touches, or -1."""
    for vehicle in range(background.x.shape[0]):
        if abs(background.elevation[vehicle] - ego[ELEVATION]) <= VEHICLE_LEVEL_HEIGHT and rectangles_touch(
            ego[X], ego[Y], ego[HEADING], ego[LENGTH], ego[WIDTH],
            background.x[vehicle], background.y[vehicle], background.heading[vehicle],
            background.length[vehicle], background.width[vehicle],
        ):  # fmt: skip
            return vehicle
    return NONE
