"""gymnasium environments in highway-env's manner."""

from .action import WaypointAction
from .ego_vehicle import EgoVehicle
from .observation import BirdEyeObservation
from .row import TownRow
from .town_env import TownEnv
from .vector_env import TownVectorEnv

__all__ = ["BirdEyeObservation", "EgoVehicle", "TownEnv", "TownRow", "TownVectorEnv", "WaypointAction"]
