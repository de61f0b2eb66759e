"""gymnasium environments in highway-env's manner."""

from athrl_driving import deferred  # noqa: F401  (before whatever imports highway-env)
from athrl_driving.envs.action import DirectAction, WaypointAction, WaypointSetAction
from athrl_driving.envs.ego_vehicle import EgoVehicle
from athrl_driving.envs.observation import BirdEyeObservation
from athrl_driving.envs.row import TownRow
from athrl_driving.envs.town_env import TownEnv
from athrl_driving.envs.vector_env import TownVectorEnv

__all__ = [
    "BirdEyeObservation",
    "DirectAction",
    "EgoVehicle",
    "TownEnv",
    "TownRow",
    "TownVectorEnv",
    "WaypointAction",
    "WaypointSetAction",
]
