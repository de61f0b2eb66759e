"""Collision checks of the ego, compiled: what it touches, and the time until it would touch a vehicle."""

import math

from athrl_driving.kernels.compilation import part
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.maps.levels import VEHICLE_LEVEL_HEIGHT
from athrl_driving.metrics import NO_COLLISION, STATIC_COLLISION, VEHICLE_COLLISION
from athrl_driving.traffic.collision import first_touched, rectangles_touch
from athrl_driving.traffic.ego_columns import ELEVATION, HEADING, LENGTH, SPEED, WIDTH, X, Y
from athrl_driving.traffic.state import NONE, Background

HORIZON = 5.0
"""Horizon of the time to collision, s; a longer time counts as infinite."""


@part
def collide(background: Background, obstacles: Floats, obstacle_count: int, ego: Floats) -> int:
    """Return the ego's collision, by kind; a vehicle that it touches is marked as crashed.

    `obstacles` is float64 [n, 5]: x, y (m), heading (rad), length, width (m) of standing obstacles.
    """
    touched = first_touched(background, ego)
    if touched != NONE:
        background.crashed[touched] = True
        return VEHICLE_COLLISION
    for obstacle in range(obstacle_count):
        if rectangles_touch(
            ego[X], ego[Y], ego[HEADING], ego[LENGTH], ego[WIDTH],
            obstacles[obstacle, 0], obstacles[obstacle, 1],
            obstacles[obstacle, 2], obstacles[obstacle, 3], obstacles[obstacle, 4],
        ):  # fmt: skip
            return STATIC_COLLISION
    return NO_COLLISION


@part
def time_to_collision(background: Background, ego: Floats) -> float:
    """Return the seconds until the ego touches a vehicle ahead if all keep their velocities, or inf."""
    cosine, sine = math.cos(ego[HEADING]), math.sin(ego[HEADING])
    nearest = math.inf
    if ego[SPEED] <= 0.0:
        return nearest
    ego_reach = 0.5 * math.hypot(ego[LENGTH], ego[WIDTH])
    for vehicle in range(background.x.shape[0]):
        dx, dy = background.x[vehicle] - ego[X], background.y[vehicle] - ego[Y]
        if (
            dx * cosine + dy * sine <= 0.0
            or abs(background.elevation[vehicle] - ego[ELEVATION]) > VEHICLE_LEVEL_HEIGHT
        ):
            continue
        length, width = background.length[vehicle], background.width[vehicle]
        speed = background.speed[vehicle]
        reach = ego_reach + 0.5 * (length + width) + HORIZON * (ego[SPEED] + speed)
        if dx * dx + dy * dy > reach * reach:
            continue
        heading = background.heading[vehicle]
        nearest = min(nearest, _time_to_touch(ego, cosine, sine, dx, dy, heading, speed, length, width))
    return nearest if nearest <= HORIZON else math.inf


@part
def _time_to_touch(
    ego: Floats,
    cosine: float,
    sine: float,
    dx: float,
    dy: float,
    heading: float,
    speed: float,
    length: float,
    width: float,
) -> float:
    """Return the seconds until two rectangles with constant velocities touch, inf if they never do.

    They touch while they overlap along all four of their axes; (dx, dy) points to the other's centre.
    """
    other_cosine, other_sine = math.cos(heading), math.sin(heading)
    drift_x, drift_y = speed * other_cosine - ego[SPEED] * cosine, speed * other_sine - ego[SPEED] * sine
    along, across = (
        abs(cosine * other_cosine + sine * other_sine),
        abs(sine * other_cosine - cosine * other_sine),
    )
    begin, end = 0.0, math.inf
    for axis in range(4):
        if axis == 0:
            x, y, reach = cosine, sine, ego[LENGTH] + length * along + width * across
        elif axis == 1:
            x, y, reach = -sine, cosine, ego[WIDTH] + length * across + width * along
        elif axis == 2:
            x, y, reach = other_cosine, other_sine, length + ego[LENGTH] * along + ego[WIDTH] * across
        else:
            x, y, reach = -other_sine, other_cosine, width + ego[LENGTH] * across + ego[WIDTH] * along
        reach *= 0.5
        apart, drift = dx * x + dy * y, drift_x * x + drift_y * y
        if abs(drift) < 1e-9:
            if abs(apart) > reach:
                return math.inf
            continue
        one, other = (-reach - apart) / drift, (reach - apart) / drift
        begin, end = max(begin, min(one, other)), min(end, max(one, other))
    return begin if begin <= end else math.inf
