"""gymnasium environments in the style of highway-env."""

from athrl_driving import deferred  # noqa: F401  (before anything imports highway-env)
from athrl_driving.envs.action import DirectAction, WaypointAction, WaypointSetAction
from athrl_driving.envs.ego_vehicle import EgoVehicle
from athrl_driving.envs.env_view import EnvView
from athrl_driving.envs.observation import BirdEyeObservation
from athrl_driving.envs.town_env import TownEnv
from athrl_driving.envs.vector_env import TownVectorEnv

__all__ = [
    "BirdEyeObservation",
    "DirectAction",
    "EgoVehicle",
    "EnvView",
    "TownEnv",
    "TownVectorEnv",
    "WaypointAction",
    "WaypointSetAction",
]
