"""What the planner sees: a bird's eye view and a lidar image around the ego, drawn by compiled kernels."""

from .drivable import DrivableMap, drivable_map
from .image import CHANNELS, Perception
from .window import EGO_ABOVE_LOWER_EDGE, WINDOW_SIDE

__all__ = [
    "CHANNELS",
    "EGO_ABOVE_LOWER_EDGE",
    "WINDOW_SIDE",
    "DrivableMap",
    "Perception",
    "drivable_map",
]
