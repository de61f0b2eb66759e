"""Towns: OpenDRIVE files, the lanes and junctions made from them, and compiled geometry."""

from athrl_driving import deferred  # noqa: F401  (before whatever imports highway-env)
from athrl_driving.maps.geometry import closest_lane, lane_elevation, lane_pose, lane_project
from athrl_driving.maps.junctions import Junction
from athrl_driving.maps.lane_graph import LaneGraph, Movements, Signals
from athrl_driving.maps.opendrive import MapError
from athrl_driving.maps.town import TOWNS, Town, load_town

__all__ = [
    "TOWNS",
    "Junction",
    "LaneGraph",
    "MapError",
    "Movements",
    "Signals",
    "Town",
    "closest_lane",
    "lane_elevation",
    "lane_pose",
    "lane_project",
    "load_town",
]
