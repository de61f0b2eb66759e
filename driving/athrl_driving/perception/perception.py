"""The image of the ego's surroundings: its settings with the town's surface in one tuple, and its drawing."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.errors import DrivingError
from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import entry, inlined
from athrl_driving.maps import Town
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.perception.drivable import DrivableMap, drivable_grid
from athrl_driving.perception.lidar import LIDAR_RANGE, RAYS, draw_lidar, measure_distances
from athrl_driving.perception.route_line import draw_route
from athrl_driving.perception.surface import draw_surface
from athrl_driving.perception.vehicles import draw_vehicles
from athrl_driving.perception.window import EGO_ABOVE_LOWER_EDGE, WINDOW_SIDE, Window
from athrl_driving.route.state import RouteState, environment_route
from athrl_driving.traffic.ego_columns import ELEVATION, HEADING, X, Y
from athrl_driving.traffic.state import Traffic, environment_traffic


class Perception(NamedTuple):
    """Settings of window and lidar, and the town; the image's size is that of the array it is drawn into."""

    window_side: float
    """m."""
    ego_above_lower_edge: float
    """m from the window's lower edge to the ego's centre, which is in the middle from left to right."""
    lidar_range: float
    """m."""
    ray_cosine: Floats
    """[rays] of each ray's angle to the ego's heading."""
    ray_sine: Floats
    """[rays]"""
    drivable: DrivableMap


def new_perception(
    town: Town,
    *,
    window_side: float = WINDOW_SIDE,
    ego_above_lower_edge: float = EGO_ABOVE_LOWER_EDGE,
    lidar_range: float = LIDAR_RANGE,
    lidar_rays: int = RAYS,
) -> Perception:
    """Prepare to draw images of a town; lengths are in metres.

    Raises ValueError, in one line, for an invalid value.
    """
    if not 4.0 <= window_side <= 1000.0:
        raise DrivingError(f"the setting window_side is {window_side!r}, it should be from 4 to 1000 m")
    if not 0.0 <= ego_above_lower_edge <= window_side:
        raise DrivingError(
            f"the setting ego_above_lower_edge is {ego_above_lower_edge!r}, "
            f"it should be from 0 to the window's side of {window_side:g} m"
        )
    if not 0.0 < lidar_range <= 1000.0:
        raise DrivingError(
            f"the setting lidar_range is {lidar_range!r}, it should be above 0, at most 1000 m"
        )
    if not 4 <= lidar_rays <= 7200:
        raise DrivingError(f"the setting lidar_rays is {lidar_rays!r}, it should be from 4 to 7200")
    angles = np.arange(lidar_rays) * (2.0 * math.pi / lidar_rays)
    return Perception(
        float(window_side),
        float(ego_above_lower_edge),
        float(lidar_range),
        np.cos(angles),
        np.sin(angles),
        drivable_grid(town),
    )


@inlined
def draw_surroundings(
    perception: Perception,
    traffic: Traffic,
    route: RouteState,
    ego: Floats,
    image: NDArray[np.uint8],
    distances: Floats,
) -> None:
    """Draw all channels of one environment into `image` uint8 [size, size, 4]; old content is overwritten.

    `distances`, float64 [rays], is filled with the lidar's distances, m, inf where there is no vehicle.

    `traffic` and `route` are the environment's views; `ego` is float64 [8]: x, y, heading, speed, length,
    width, elevation, present.
    """
    heading, elevation = ego[HEADING], ego[ELEVATION]
    window = Window(
        ego[X],
        ego[Y],
        math.cos(heading),
        math.sin(heading),
        perception.window_side / image.shape[0],
        perception.window_side - perception.ego_above_lower_edge,
        0.5 * perception.window_side,
    )
    draw_surface(image, window, perception.drivable, elevation)
    draw_vehicles(image, window, heading, elevation, traffic.graph, traffic.background)
    draw_route(image, window, elevation, traffic, route)
    measure_distances(
        window,
        heading,
        elevation,
        perception.lidar_range,
        perception.ray_cosine,
        perception.ray_sine,
        traffic.background,
        distances,
    )
    draw_lidar(image, window, distances, perception.ray_cosine, perception.ray_sine)


@entry
def draw_image(
    perception: Perception,
    traffic: Traffic,
    routes: RouteState,
    environment: int,
    ego: Floats,
    image: NDArray[np.uint8],
    distances: Floats,
) -> None:
    """Draw the image of one environment, for calls from Python; see `draw_surroundings`."""
    own_traffic = environment_traffic(by_reference(traffic), environment)
    own_route = environment_route(by_reference(routes), environment)
    draw_surroundings(
        by_reference(perception), by_reference(own_traffic), by_reference(own_route), ego, image, distances
    )
