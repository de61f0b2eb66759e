"""Driving through a town with traffic: one decision every four ticks, the paper's reward and endings."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from numpy.typing import NDArray

from athrl_driving.envs.action import make_action
from athrl_driving.envs.observation import BirdEyeObservation
from athrl_driving.envs.row import TownRow
from athrl_driving.envs.settings import (
    DEFAULTS,
    changed_settings,
    first_settings,
    new_episodes,
    refuse_arguments,
    town_of,
)
from athrl_driving.episode import BEGIN, DRIVE, SEE, TAKE, TICK, Episodes
from athrl_driving.errors import DrivingError
from athrl_driving.maps import Town
from athrl_driving.reward import REWARD_TERMS
from athrl_driving.route import Route
from athrl_driving.scene import Scene

if TYPE_CHECKING:
    from athrl_driving.envs.viewer import TownViewer

_REMADE = (
    "viewer",
    "_record_video_wrapper",
    "road",
    "controlled_vehicles",
    "_row",
    "observation_type",
    "action_type",
)
"""What a copy of an environment does not take over."""

_ONLY = np.zeros(1, np.int64)


class TownEnv(AbstractEnv):
    """The paper's task: an episode ends at the tick of a collision or of leaving the lane, or after 500.

    `map` is a town's name or the path of an OpenDRIVE file (.xodr) and stands for the setting `town`;
    `scenario` is the id of a case study, whose settings are then the defaults.
    """

    config: dict[str, Any]
    enable_auto_render: bool
    viewer: TownViewer | None
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["human", "rgb_array"], "render_fps": 5}

    def __init__(
        self,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        map: str | None = None,
        scenario: str | None = None,
        **others: Any,
    ) -> None:
        refuse_arguments(others)
        if render_mode not in (None, "human", "rgb_array"):
            raise DrivingError(f"render_mode is {render_mode!r}, it should be None, 'human' or 'rgb_array'")
        self._map = map
        self._scenario = scenario
        super().__init__(config, render_mode)

    @classmethod
    def default_config(cls) -> dict:
        """All settings with their defaults."""
        return {**super().default_config(), **DEFAULTS}

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Take settings; raises ValueError that names a key that does not exist or a value that cannot be."""
        if self._scenario is not None:
            self.config = first_settings(self.config, self._scenario)
            self._scenario = None
        settings = changed_settings(self.config, config, self._map)
        self.town: Town = town_of(settings)  # before they are taken over, as there may be no such town
        super().configure(settings)
        self._episodes: Episodes | None = None
        self._spaces_are_current = False

    @property
    def episodes(self) -> Episodes:
        """The arrays of the episode, a batch of one."""
        if self._episodes is None:
            self._episodes = new_episodes(self.config, self.town, 1)
        return self._episodes

    def define_spaces(self) -> None:
        """Make observation and action; unlike in highway-env they last, with their seeds, over resets."""
        if self._spaces_are_current:
            return
        self.observation_type = BirdEyeObservation(self)
        self.action_type = make_action(self)
        self.observation_space = self.observation_type.space()
        self.action_space = self.action_type.space()
        self._spaces_are_current = True

    @property
    def route(self) -> Route:
        """Where the ego is to go."""
        return self._row.route

    @property
    def decisions(self) -> int:
        """Decisions since the episode began."""
        return int(self.episodes.state.progress.decisions[0])

    def _reset(self) -> None:
        self.episodes.begin(_ONLY, [self.np_random])
        self._show()

    def _show(self) -> None:
        """Make highway-env's view of the arrays."""
        self._row = TownRow(self.episodes, 0, self.config)
        self.road = self._row.road
        self.controlled_vehicles = [self._row.vehicle]

    def __deepcopy__(self, memo: dict) -> TownEnv:
        """Copy the episode, for planners that try actions out; the town is shared, the viewer left out."""
        result = type(self).__new__(type(self))
        memo[id(self)] = result
        memo[id(self.town)] = self.town
        for name, value in self.__dict__.items():
            if name not in _REMADE:
                setattr(result, name, copy.deepcopy(value, memo))
        result.viewer = result._record_video_wrapper = None
        result.observation_type, result.action_type = BirdEyeObservation(result), make_action(result)
        result._show()
        return result

    def _do(self, work: int, action: NDArray[np.float32] | None = None) -> None:
        self.episodes.work(work, None if action is None else action[None])
        self.steps = int(self.episodes.state.progress.ticks[0])
        self.time = self.steps / self.config["simulation_frequency"]

    def step(self, action: NDArray[np.floating] | None) -> tuple[dict, float, bool, bool, dict[str, Any]]:
        """Make one decision of the kind that `action_space` tells; without one, the last one holds on.

        Raises DrivingError for an action that is none, before anything moves.
        """
        return super().step(None if action is None else self.action_type.checked(action, (2,)))

    def _simulate(self, action: NDArray[np.floating] | None = None) -> None:
        """Let a decision hold for its ticks or until the episode ends; without one the last one holds on."""
        begin = BEGIN if action is None else BEGIN + TAKE
        self.road.hand_over_objects()
        if self.viewer is None or not self.enable_auto_render:
            self._do(begin + DRIVE + SEE, action)
        else:
            self._simulate_and_render(begin, action)
        self.enable_auto_render = False

    def _simulate_and_render(self, begin: int, action: NDArray[np.floating] | None) -> None:
        """Draw every tick of the decision: what `render` shows is then as smooth as the simulation."""
        self._do(begin, action)
        for tick in range(self.config["ticks_per_decision"]):
            if tick:
                self._automatic_rendering()
            self._do(TICK)
            if self._is_terminated() or self._is_truncated():
                break
        self._do(SEE)

    def _rewards(self, action: NDArray[np.floating]) -> dict[str, float]:
        return dict(zip(REWARD_TERMS, self.episodes.state.progress.terms[0].tolist(), strict=True))

    def _reward(self, action: NDArray[np.floating]) -> float:
        return float(self.episodes.state.progress.reward[0])

    def _is_terminated(self) -> bool:
        return bool(self.episodes.state.progress.terminated[0])

    def _is_truncated(self) -> bool:
        return bool(self.episodes.state.progress.truncated[0])

    def _info(self, obs: dict, action: NDArray[np.floating] | None = None) -> dict[str, Any]:
        return self.episodes.info(0)

    def render(self) -> NDArray[np.uint8] | None:
        """Show the town around the ego: a picture, uint8 [height, width, 3], or a window (`human`)."""
        if self.viewer is None and self.render_mode is not None:
            from athrl_driving.envs.viewer import TownViewer  # for nobody who renders nothing

            self.viewer = TownViewer(self, offscreen=self.config["offscreen_rendering"])
        return super().render()

    def scene(self) -> Scene:
        """The present moment, for a live view or a recording."""
        return self._row.scene()
