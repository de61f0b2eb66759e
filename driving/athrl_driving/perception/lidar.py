"""Channel 3, lidar: rays from the ego's centre that end at the first vehicle they hit.

Vehicles behind another one are not seen. A pixel's brightness is 255 where at least one ray ended.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from athrl_driving.kernels.compilation import inlined, part
from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.perception.window import Window, column_of, row_of
from athrl_driving.traffic.state import Background

RAYS = 180
"""Default number of rays around the ego: 2 degrees apart, 0.7 m at the window's far edge."""

LIDAR_RANGE = 40.0
"""Default range of a ray, m."""


@part
def measure_distances(
    window: Window,
    heading: float,
    elevation: float,
    reach: float,
    ray_cosine: NDArray[np.float64],
    ray_sine: NDArray[np.float64],
    vehicles: Background,
    distances: NDArray[np.float64],
) -> None:
    """Fill `distances` [rays]: metres to the first vehicle in each direction, inf where none is in `reach`.

    Ray i points i * 360 / rays degrees to the right of the ego's heading.
    """
    rays = ray_cosine.shape[0]
    distances[:] = math.inf
    spacing = 2.0 * math.pi / rays
    x, y, headings, heights = vehicles.x, vehicles.y, vehicles.heading, vehicles.elevation
    lengths, widths = vehicles.length, vehicles.width
    for vehicle in range(x.shape[0]):
        dx, dy = x[vehicle] - window.x, y[vehicle] - window.y
        half_length, half_width = 0.5 * lengths[vehicle], 0.5 * widths[vehicle]
        farthest = reach + half_length + half_width
        if dx * dx + dy * dy > farthest * farthest:
            continue
        if abs(heights[vehicle] - elevation) > ROAD_LEVEL_HEIGHT:
            continue
        # Only the rays that may hit the circle around the vehicle.
        apart, radius = math.hypot(dx, dy), math.hypot(half_length, half_width)
        spread = math.pi if apart <= radius else math.asin(radius / apart)
        bearing = math.atan2(dy, dx) - heading
        first = math.ceil((bearing - spread) / spacing)
        count = min(math.floor((bearing + spread) / spacing) - first + 1, rays)
        angle = heading - headings[vehicle]
        cosine, sine = math.cos(angle), math.sin(angle)
        own_cosine, own_sine = math.cos(headings[vehicle]), math.sin(headings[vehicle])
        along, across = -(dx * own_cosine + dy * own_sine), dx * own_sine - dy * own_cosine
        ray = first % rays
        for _ in range(count):
            step_along = ray_cosine[ray] * cosine - ray_sine[ray] * sine
            step_across = ray_cosine[ray] * sine + ray_sine[ray] * cosine
            distance = _distance_to_box(along, across, step_along, step_across, half_length, half_width)
            if distance <= reach and distance < distances[ray]:
                distances[ray] = distance
            ray += 1
            if ray == rays:
                ray = 0


@inlined
def _distance_to_box(
    along: float, across: float, step_along: float, step_across: float, half_length: float, half_width: float
) -> float:
    """Metres from a point to a box about the origin in a direction, 0 inside, inf where the ray misses it."""
    near, far = 0.0, math.inf
    if abs(step_along) > 1e-12:
        one, other = (-half_length - along) / step_along, (half_length - along) / step_along
        near, far = max(near, min(one, other)), min(far, max(one, other))
    elif abs(along) > half_length:
        return math.inf
    if abs(step_across) > 1e-12:
        one, other = (-half_width - across) / step_across, (half_width - across) / step_across
        near, far = max(near, min(one, other)), min(far, max(one, other))
    elif abs(across) > half_width:
        return math.inf
    return near if near <= far else math.inf


@inlined
def draw_lidar(
    image: NDArray[np.uint8],
    window: Window,
    distances: NDArray[np.float64],
    ray_cosine: NDArray[np.float64],
    ray_sine: NDArray[np.float64],
) -> None:
    """Mark on channel 3 the pixels where rays ended."""
    for ray in range(distances.shape[0]):
        if distances[ray] == math.inf:
            continue
        row = round(row_of(window, distances[ray] * ray_cosine[ray]))
        column = round(column_of(window, distances[ray] * ray_sine[ray]))
        if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
            image[row, column, 3] = 255
