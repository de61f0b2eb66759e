"""One line for highway-env's users: the traffic of an environment they have, compiled."""

from __future__ import annotations

from typing import TypeVar

import gymnasium
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.observation import ObservationType
from highway_env.road.road import Road

from athrl_driving.compilation import announce_compilation
from athrl_driving.highway import kernels
from athrl_driving.highway.known import UnknownClassError
from athrl_driving.highway.observation import accelerate_observation
from athrl_driving.highway.road import accelerate_road
from athrl_driving.highway.standing_in import standing_in

Environment = TypeVar("Environment", bound=gymnasium.Env)


def accelerate(env: Environment) -> Environment:
    """Run the traffic of a highway-env environment, wrapped or not, in compiled kernels; return it.

    Works before and after `reset` and at every later one. Observations, rewards, ends and `info` stay what
    they are. Raises `UnknownClassError` (a `ValueError`), at once or at a later reset, that names the class
    of a vehicle, an object, a lane or a road which the kernels do not know.
    """
    plain = env.unwrapped
    if not isinstance(plain, AbstractEnv):
        name = f"{type(plain).__module__}.{type(plain).__qualname__}"
        raise UnknownClassError(f"cannot accelerate {name}: it is not an environment of highway-env")
    announce_compilation(kernels.step, 30)
    if not isinstance(plain, AcceleratedEnvironment):
        plain.__class__ = standing_in(type(plain), AcceleratedEnvironment)
        plain.road = plain.__dict__.get("road")
        plain.observation_type = plain.__dict__.get("observation_type")
    return env


class AcceleratedEnvironment:
    """What makes an environment accelerate every road that it is given."""

    __slots__ = ()

    @property
    def road(self) -> Road | None:
        """The road."""
        return self.__dict__.get("road")

    @road.setter
    def road(self, road: Road | None) -> None:
        if road is not None:
            accelerate_road(road)
        self.__dict__["road"] = road

    @property
    def observation_type(self) -> ObservationType | None:
        """What observes."""
        return self.__dict__.get("observation_type")

    @observation_type.setter
    def observation_type(self, observation: ObservationType | None) -> None:
        if observation is not None:
            accelerate_observation(observation)
        self.__dict__["observation_type"] = observation
