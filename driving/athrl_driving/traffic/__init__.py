"""Background traffic: compiled car-following, right of way at junctions, and highway-env's view of it."""

from athrl_driving.traffic.road import TrafficRoad
from athrl_driving.traffic.state import Background, starting_places
from athrl_driving.traffic.vehicle import BackgroundVehicle

__all__ = ["Background", "BackgroundVehicle", "TrafficRoad", "starting_places"]
