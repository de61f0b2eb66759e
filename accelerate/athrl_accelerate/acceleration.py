"""`accelerate`: one call that compiles the traffic of a highway-env environment."""

from __future__ import annotations

from functools import cache
from typing import Any, TypeVar

import gymnasium
from athrl_driving.kernels.compilation import compiled_once, prepare
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.observation import ObservationType
from highway_env.road.road import Road, RoadNetwork

from athrl_accelerate import kernels
from athrl_accelerate.grid import FEW_LANES
from athrl_accelerate.mixins import class_with_mixin
from athrl_accelerate.observation import accelerate_observation
from athrl_accelerate.road import accelerate_road
from athrl_accelerate.supported_classes import UnknownClassError

Environment = TypeVar("Environment", bound=gymnasium.Env)

_COMPILE_SECONDS = 30


def accelerate(env: Environment) -> Environment:
    """Run the traffic of a highway-env environment, wrapped or not, in compiled kernels; return it.

    Works before and after `reset`, and at every later reset. Observations, rewards, ends and `info` stay the
    same. The first call of an installation compiles the kernels and says so in one logged line. Raises
    `UnknownClassError` (a `ValueError`), at once or at a later reset, which names the class of a vehicle, an
    object, a lane or a road that the kernels do not know.
    """
    plain = getattr(env, "unwrapped", env)
    if not isinstance(plain, AbstractEnv):
        name = f"{type(plain).__module__}.{type(plain).__qualname__}"
        raise UnknownClassError(f"cannot accelerate {name}: it is not an environment of highway-env")
    if not isinstance(plain, AcceleratedEnvironment):
        plain.__class__ = class_with_mixin(type(plain), AcceleratedEnvironment)
        plain.road = plain.__dict__.get("road")
        plain.observation_type = plain.__dict__.get("observation_type")
        _prepare_kernels()
    return env


@cache
def _prepare_kernels() -> None:
    """Compile or load the kernels, so that no step and no observation has to."""
    with compiled_once(kernels.step, "highway-env's traffic", _COMPILE_SECONDS):
        _load_kernels()


def _load_kernels() -> None:
    lanes = FEW_LANES + 1  # with as many there is a grid to fill
    road = Road(RoadNetwork.straight_road_network(lanes=lanes, length=10.0))
    accelerate_road(road)
    table = road.table
    rows, network, scratch = table.rows, table.network.arrays, table.scratch
    prepare(kernels.find_lane, network, 0.0, 0.0, 0.0)
    prepare(kernels.find_neighbours, rows, network, scratch, 0, 0, False, 0, 0)
    prepare(kernels.find_close, rows, network, 0, 0, 0, 0.0, 0.0, False, table.found, table.ahead)
    prepare(kernels.act, rows, network, scratch, 0, 0, False)
    prepare(kernels.step, rows, network, scratch, 0, 0, 0.0, False, 0.0)


class AcceleratedEnvironment:
    """Mixin of an environment that accelerates every road that it is given."""

    __slots__ = ()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the state of a pickled environment; its process may have no kernels yet."""
        self.__dict__.update(state)
        _prepare_kernels()

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
        """The observation type."""
        return self.__dict__.get("observation_type")

    @observation_type.setter
    def observation_type(self, observation: ObservationType | None) -> None:
        if observation is not None:
            accelerate_observation(observation)
        self.__dict__["observation_type"] = observation
