"""The interface of drivers."""

from __future__ import annotations

from abc import ABC, abstractmethod

import gymnasium
import numpy as np
from numpy.typing import NDArray

from athrl_driving.envs import EnvView, TownEnv, WaypointAction
from athrl_driving.errors import DrivingError

DrivenTown = TownEnv | EnvView
"""A town environment, or one environment of a batch of them."""


class Driver(ABC):
    """Decides for the ego of a town environment, which may be wrapped."""

    def reset(self, env: gymnasium.Env | EnvView, seed: int) -> None:
        """Begin an episode of `env`, which has been reset; `seed` determines the driver's random numbers."""
        town_of(env)

    @abstractmethod
    def act(self, env: gymnasium.Env | EnvView) -> NDArray[np.float32]:
        """float32 [2] action within [-1, 1] for the environment's present moment."""


def town_of(env: gymnasium.Env | EnvView) -> DrivenTown:
    """The town environment inside its wrappers.

    Raises TypeError that names another class of environment, and DrivingError for another kind of action.
    """
    town = env.unwrapped
    if not isinstance(town, (TownEnv, EnvView)):
        raise TypeError(f"a driver needs a TownEnv, this is a {type(town).__name__}")
    if not isinstance(town.action_type, WaypointAction):
        name = type(town.action_type).__name__
        raise DrivingError(f"a driver decides in WaypointAction, the environment takes {name}")
    return town
