"""gymnasium environments in highway-env's manner."""

from .action import WaypointAction
from .ego_vehicle import EgoVehicle
from .observation import BirdEyeObservation
from .town_env import TownEnv

__all__ = ["BirdEyeObservation", "EgoVehicle", "TownEnv", "WaypointAction"]
