"""The planner's image: the four channels of the window, drawn in one compiled call."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..compilation import compiled
from ..maps import LaneGraph
from ..route import Route
from .before.drivable import DrivableMap, sample_drivable_map
from .before.lidar import draw_lidar, lidar_distances
from .before.route_line import draw_route
from .before.vehicles import draw_vehicles
from .before.window import WINDOW_SIDE

CHANNELS = ("drivable", "vehicles", "route", "lidar")
"""What the channels of the image show, in order."""


class VehicleArrays(Protocol):
    """Vehicles as columns, float64 [n] in m, rad, m/s; `lane` int64 [n] is a row of the lane graph."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    heading: NDArray[np.float64]
    speed: NDArray[np.float64]
    length: NDArray[np.float64]
    width: NDArray[np.float64]
    lane: NDArray[np.int64]


class Perception:
    """Draws the image of one environment."""

    def __init__(self, drivable: DrivableMap, graph: LaneGraph, image_size: int) -> None:
        self.drivable = drivable
        self.graph = graph
        self.image_size = image_size

    def observe(
        self, x: float, y: float, heading: float, vehicles: VehicleArrays, route: Route
    ) -> NDArray[np.uint8]:
        """uint8 [size, size, 4] seen from a pose (m, rad); a new array at each call."""
        return draw_image(
            self.image_size,
            self.drivable.cells,
            self.drivable.left,
            self.drivable.top,
            self.graph,
            route.pieces,
            route.position,
            x,
            y,
            heading,
            vehicles.x,
            vehicles.y,
            vehicles.heading,
            vehicles.speed,
            vehicles.lane,
            vehicles.length,
            vehicles.width,
        )


@compiled
def draw_image(
    size: int,
    cells: NDArray[np.uint8],
    left: float,
    top: float,
    graph: LaneGraph,
    pieces: NDArray[np.float64],
    route_position: float,
    ego_x: float,
    ego_y: float,
    ego_heading: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    heading: NDArray[np.float64],
    speed: NDArray[np.float64],
    lane: NDArray[np.int64],
    length: NDArray[np.float64],
    width: NDArray[np.float64],
) -> NDArray[np.uint8]:
    """Draw all channels; a vehicle's rate of turning is what its speed on its lane's curvature makes."""
    image = np.zeros((size, size, 4), dtype=np.uint8)
    pixel = WINDOW_SIDE / size
    turning = np.empty(x.size)
    for vehicle in range(x.size):
        turning[vehicle] = speed[vehicle] * graph.curvature[lane[vehicle]]
    sample_drivable_map(image, cells, left, top, pixel, ego_x, ego_y, ego_heading)
    draw_vehicles(image, pixel, ego_x, ego_y, ego_heading, x, y, heading, speed, turning, length, width)
    draw_route(image, pixel, ego_x, ego_y, ego_heading, pieces, pieces.shape[0], route_position)
    distances = lidar_distances(ego_x, ego_y, ego_heading, x, y, heading, length, width)
    draw_lidar(image, pixel, distances)
    return image
