"""Towns: short descriptions, the lanes built from them, and compiled geometry."""

from athrl_driving.maps.description import Bend, Node, Street, TownDescription
from athrl_driving.maps.geometry import closest_lane, lane_elevation, lane_pose, lane_project
from athrl_driving.maps.lane_graph import LaneGraph, Movements, Signals
from athrl_driving.maps.town import TOWNS, Junction, Town, build_town, load_town

__all__ = [
    "TOWNS",
    "Bend",
    "Junction",
    "LaneGraph",
    "Movements",
    "Node",
    "Signals",
    "Street",
    "Town",
    "TownDescription",
    "build_town",
    "closest_lane",
    "lane_elevation",
    "lane_pose",
    "lane_project",
    "load_town",
]
