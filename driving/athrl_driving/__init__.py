"""Towns, traffic, perception and control as gymnasium environments over highway-env.

Importing the package registers its environments with gymnasium and imports nothing heavier than gymnasium;
everything else is imported when its name is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from athrl_spaces import CASE_STUDIES
from athrl_spaces.first_use import on_first_use
from gymnasium.envs.registration import register, registry

if TYPE_CHECKING:
    from athrl_driving.drivers import BlindRouteFollower, Driver, RandomDriver, RuleBasedDriver, make_driver
    from athrl_driving.envs import TownEnv, TownVectorEnv
    from athrl_driving.scene import Scene, VehiclePose, lane_polylines

__all__ = [
    "BlindRouteFollower",
    "Driver",
    "RandomDriver",
    "RuleBasedDriver",
    "Scene",
    "TownEnv",
    "TownVectorEnv",
    "VehiclePose",
    "lane_polylines",
    "make_driver",
]

__getattr__ = on_first_use(
    __name__,
    {
        "BlindRouteFollower": "drivers",
        "Driver": "drivers",
        "RandomDriver": "drivers",
        "RuleBasedDriver": "drivers",
        "Scene": "scene",
        "TownEnv": "envs",
        "TownVectorEnv": "envs",
        "VehiclePose": "scene",
        "lane_polylines": "scene",
        "make_driver": "drivers",
    },
)

_ARGUMENTS_OF_ID: dict[str, dict[str, str]] = {
    "athrl/Town02-v0": {"map": "town02"},
    "athrl/Town03-v0": {"map": "town03"},
    "athrl/Town04-v0": {"map": "town04"},
    "athrl/OpenDrive-v0": {"map": ""},  # named by the user
    **{scenario: {"scenario": scenario} for scenario in CASE_STUDIES.values()},
}


def _register_environments() -> None:
    """Register environments that are not registered yet; a second import, as by `package:id`, is no error."""
    for name, arguments in _ARGUMENTS_OF_ID.items():
        if name not in registry:
            register(
                id=name,
                entry_point="athrl_driving.envs:TownEnv",
                vector_entry_point="athrl_driving.envs:TownVectorEnv",
                kwargs=arguments,
            )


_register_environments()
