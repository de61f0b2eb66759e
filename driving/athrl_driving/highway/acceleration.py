"""One line for highway-env's users: the traffic of an environment they have, compiled."""

from __future__ import annotations

from functools import cache
from typing import TypeVar

import gymnasium
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.observation import ObservationType
from highway_env.road.road import Road, RoadNetwork

from athrl_driving.compilation import compiled_once, prepare
from athrl_driving.highway import kernels
from athrl_driving.highway.grid import FEW_LANES
from athrl_driving.highway.known import UnknownClassError
from athrl_driving.highway.observation import accelerate_observation
from athrl_driving.highway.road import accelerate_road
from athrl_driving.highway.standing_in import standing_in

Environment = TypeVar("Environment", bound=gymnasium.Env)

_COMPILE_SECONDS = 30


def accelerate(env: Environment) -> Environment:
    """Run the traffic of a highway-env environment, wrapped or not, in compiled kernels; return it.

    Works before and after `reset` and at every later one. Observations, rewards, ends and `info` stay what
    they are. The first call of an installation compiles the kernels and says so in one logged line. Raises
    `UnknownClassError` (a `ValueError`), at once or at a later reset, that names the class of a vehicle, an
    object, a lane or a road which the kernels do not know.
    """
    plain = getattr(env, "unwrapped", env)
    if not isinstance(plain, AbstractEnv):
        name = f"{type(plain).__module__}.{type(plain).__qualname__}"
        raise UnknownClassError(f"cannot accelerate {name}: it is not an environment of highway-env")
    if not isinstance(plain, AcceleratedEnvironment):
        with compiled_once(kernels.step, "highway-env's traffic", _COMPILE_SECONDS):
            plain.__class__ = standing_in(type(plain), AcceleratedEnvironment)
            plain.road = plain.__dict__.get("road")
            plain.observation_type = plain.__dict__.get("observation_type")
            _prepare_kernels()
    return env


@cache
def _prepare_kernels() -> None:
    """Compile the kernels, or load them, so that no step and no observation has to."""
    lanes = FEW_LANES + 1  # with as many there is a grid to fill
    road = Road(RoadNetwork.straight_road_network(lanes=lanes, length=10.0))
    accelerate_road(road)
    table = road.table
    rows, network, scratch = table.rows, table.network.arrays, table.scratch
    prepare(kernels.find_lane, network, 0.0, 0.0, 0.0)
    prepare(kernels.look, rows, network, scratch, 0, 0, False, 0, 0)
    prepare(kernels.find_close, rows, network, 0, 0, 0, 0.0, 0.0, False, table.found, table.ahead)
    prepare(kernels.act, rows, network, scratch, 0, 0, False)
    prepare(kernels.step, rows, network, scratch, 0, 0, 0.0, False, 0.0)


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
