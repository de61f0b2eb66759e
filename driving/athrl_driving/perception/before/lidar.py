"""Channel 3, lidar: rays from the ego's centre that end on the first vehicle they meet.

What stands behind another vehicle is not seen. A pixel's brightness is 255 where at least one ray ended.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...compilation import compiled, inlined
from .window import column_of, row_of

RAYS = 180
"""Rays round the ego; 2 degrees apart, 0.7 m at the window's far edge."""

LIDAR_RANGE = 40.0
"""How far a ray reaches, m."""


@compiled
def lidar_distances(
    ego_x: float,
    ego_y: float,
    ego_heading: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    heading: NDArray[np.float64],
    length: NDArray[np.float64],
    width: NDArray[np.float64],
) -> NDArray[np.float64]:
    """float64 [RAYS]: metres to the first vehicle in each direction, inf where none is within the range.

    Ray i points i * 360 / RAYS degrees to the right of the ego's heading.
    """
    distances = np.full(RAYS, np.inf)
    spacing = 2 * math.pi / RAYS
    for vehicle in range(x.size):
        dx, dy = x[vehicle] - ego_x, y[vehicle] - ego_y
        half_length, half_width = length[vehicle] / 2, width[vehicle] / 2
        apart = math.hypot(dx, dy)
        radius = math.hypot(half_length, half_width)
        if apart - radius > LIDAR_RANGE:
            continue
        # Only the rays that may meet the circle round the vehicle.
        spread = math.pi if apart <= radius else math.asin(radius / apart)
        bearing = math.atan2(dy, dx) - ego_heading
        first = math.floor((bearing - spread) / spacing)
        last = min(math.ceil((bearing + spread) / spacing), first + RAYS - 1)
        cosine, sine = math.cos(heading[vehicle]), math.sin(heading[vehicle])
        origin_along, origin_across = -(dx * cosine + dy * sine), -(dy * cosine - dx * sine)
        for ray in range(first, last + 1):
            angle = ray * spacing + ego_heading - heading[vehicle]
            distance = _distance_to_box(
                origin_along, origin_across, math.cos(angle), math.sin(angle), half_length, half_width
            )
            if distance <= LIDAR_RANGE and distance < distances[ray % RAYS]:
                distances[ray % RAYS] = distance
    return distances


@inlined
def _distance_to_box(
    along: float, across: float, step_along: float, step_across: float, half_length: float, half_width: float
) -> float:
    """Metres from a point to a box about the origin in a direction, 0 inside, inf where the ray misses it."""
    near, far = 0.0, np.inf
    for axis in range(2):
        start = along if axis == 0 else across
        step = step_along if axis == 0 else step_across
        half = half_length if axis == 0 else half_width
        if abs(step) < 1e-12:
            if abs(start) > half:
                return np.inf
            continue
        one, other = (-half - start) / step, (half - start) / step
        near, far = max(near, min(one, other)), min(far, max(one, other))
    return near if near <= far else np.inf


@compiled
def draw_lidar(image: NDArray[np.uint8], pixel: float, distances: NDArray[np.float64]) -> None:
    """Mark on channel 3 the pixels where rays ended."""
    spacing = 2 * math.pi / RAYS
    for ray in range(distances.size):
        if distances[ray] == np.inf:
            continue
        row = round(row_of(distances[ray] * math.cos(ray * spacing), pixel))
        column = round(column_of(distances[ray] * math.sin(ray * spacing), pixel))
        if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
            image[row, column, 3] = 255
