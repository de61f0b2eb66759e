"""The planner's observation: bird's eye view and lidar image around the ego, drawn by compiled kernels."""

from athrl_driving.perception.drivable import DrivableMap, draw_drivable_map, drivable_grid
from athrl_driving.perception.lidar import LIDAR_RANGE, RAYS
from athrl_driving.perception.perception import (
    Perception,
    draw_image,
    draw_surroundings,
    new_perception,
)
from athrl_driving.perception.window import EGO_ABOVE_LOWER_EDGE, WINDOW_SIDE

__all__ = [
    "EGO_ABOVE_LOWER_EDGE",
    "LIDAR_RANGE",
    "RAYS",
    "WINDOW_SIDE",
    "DrivableMap",
    "Perception",
    "draw_drivable_map",
    "draw_image",
    "draw_surroundings",
    "drivable_grid",
    "new_perception",
]
