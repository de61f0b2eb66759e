"""Driving through a town with traffic: one decision every four ticks, the paper's reward and endings."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from numpy.typing import NDArray

from athrl_driving.envs.action import make_action
from athrl_driving.envs.arguments import map_argument, refuse_arguments
from athrl_driving.envs.env_view import EnvView
from athrl_driving.envs.observation import BirdEyeObservation
from athrl_driving.envs.reset_options import CONFIG, checked_options, with_written, written_settings
from athrl_driving.envs.settings import (
    DEFAULTS,
    changed_settings,
    first_settings,
    new_episodes,
    town_of,
)
from athrl_driving.envs.spec import PlainSpec
from athrl_driving.episode import BEGIN, DRIVE, OBSERVE, SET_ACTION, TICK, Episodes
from athrl_driving.errors import DrivingError
from athrl_driving.maps import Town
from athrl_driving.reward import REWARD_TERMS
from athrl_driving.route import Route
from athrl_driving.scene import Scene

if TYPE_CHECKING:
    from athrl_driving.envs.viewer import TownViewer

_REMADE = frozenset(
    {
        "viewer",
        "_record_video_wrapper",
        "road",
        "controlled_vehicles",
        "observation_type",
        "action_type",
    }
)
"""Attributes that a copy of an environment does not copy."""

_ONLY = np.zeros(1, np.int64)


class TownEnv(PlainSpec, AbstractEnv):
    """The paper's task: an episode ends at the tick of a collision or a lane exit, or after 500 ticks.

    `map` is a town's name or the path of an OpenDRIVE file (.xodr) and replaces the setting `town`;
    `scenario` is the id of a case study, whose settings are then the defaults.
    """

    config: dict[str, Any]
    enable_auto_render: bool
    viewer: TownViewer | None
    metadata: dict[str, Any]
    town: Town
    episodes: Episodes
    """The arrays of the episode, a batch of one."""

    def __init__(
        self,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        map: str | os.PathLike[str] | None = None,
        scenario: str | None = None,
        **others: Any,
    ) -> None:
        refuse_arguments(others, type(self).__init__, self.default_config())
        if render_mode not in (None, "human", "rgb_array"):
            raise DrivingError(f"render_mode is {render_mode!r}, it should be None, 'human' or 'rgb_array'")
        self._map = map_argument(map, config)
        self._scenario = scenario
        self.metadata = dict(type(self).metadata)  # highway-env's dict is that of all environments
        super().__init__(config, render_mode)

    @classmethod
    def default_config(cls) -> dict:
        """All settings with their defaults, in values of the caller's own."""
        return {**super().default_config(), **copy.deepcopy(DEFAULTS)}

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Change settings, also those that were written to `config`.

        Raises ValueError that names an unknown key or an invalid value.
        """
        if self._scenario is not None:
            self.config = first_settings(self.config, self._scenario)
            self._scenario = None
        adopted = self.__dict__.get("_adopted_config", self.config)
        settings = changed_settings(adopted, with_written(config, self.config, adopted), self._map)
        town = town_of(settings, adopted, self.__dict__.get("town"))
        episodes = new_episodes(settings, town, 1)
        super().configure(settings)  # only now: towns and places that do not exist have been refused
        self._adopted_config = copy.deepcopy(self.config)
        self.town, self.episodes = town, episodes
        self._spaces_are_current = False
        if self.viewer is not None:  # it has drawn the ground of the town before
            self.viewer.close()
            self.viewer = None

    def update_metadata(self, video_real_time_ratio: float = 1) -> None:
        """Set the pictures a second such that a video plays in real time; highway-env's are twice as fast."""
        super().update_metadata(video_real_time_ratio)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, NDArray], dict[str, Any]]:
        """Begin a new episode, after the settings of `options["config"]` have been changed, if there are any.

        So are those that were written to `config`. Raises DrivingError in one line for another option, an
        unknown setting or an invalid value.
        """
        changes = checked_options(options, (CONFIG,)).get(CONFIG)
        if changes is not None or written_settings(self.config, self._adopted_config):
            self.configure(changes)
        return super().reset(seed=seed)

    def define_spaces(self) -> None:
        """Make the spaces; unlike in highway-env they and their seeds persist over resets."""
        if self._spaces_are_current:
            return
        self.observation_type = BirdEyeObservation(self)
        self.action_type = make_action(self)
        self.observation_space = self.observation_type.space()
        self.action_space = self.action_type.space()
        self._spaces_are_current = True

    @property
    def route(self) -> Route:
        """The ego's route."""
        return self._view.route

    @property
    def decisions(self) -> int:
        """Decisions since the episode began."""
        return int(self.episodes.state.progress.decisions[0])

    def _reset(self) -> None:
        self.episodes.begin(_ONLY, [self.np_random])
        self._view = EnvView(self.episodes, 0, self.config)
        self._show()

    def _show(self) -> None:
        """Make highway-env's view of the arrays."""
        self.road = self._view.road
        self.controlled_vehicles = [self._view.vehicle]

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs in the same state, in this process or in another; the town by its file.

        Raises DrivingError for an open window, which stays in its process, and while a thread steps.
        """
        if self.viewer is not None and not self.viewer.offscreen:
            raise DrivingError("an environment with an open window cannot be pickled: close() it before")
        return self._copied_attributes()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the state of another environment, which is independent of this one."""
        self.__dict__.update(state)
        self.viewer = self._record_video_wrapper = None
        self.observation_type, self.action_type = BirdEyeObservation(self), make_action(self)
        self._show()

    def __deepcopy__(self, memo: dict) -> TownEnv:
        """Copy the episode, for planners that simulate actions; the town is shared, the viewer left out."""
        result = type(self).__new__(type(self))
        memo[id(self)] = result
        result.__setstate__(copy.deepcopy(self._copied_attributes(), memo))
        return result

    def _copied_attributes(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in _REMADE}

    def _do(self, work: int, action: NDArray[np.float32] | None = None) -> None:
        self.episodes.work(work, None if action is None else action[None])
        self.steps = int(self.episodes.state.progress.ticks[0])
        self.time = self.steps / self.config["simulation_frequency"]

    def step(self, action: NDArray[np.floating] | None) -> tuple[dict, float, bool, bool, dict[str, Any]]:
        """Make one decision with an action of `action_space`; None keeps the last decision.

        Raises DrivingError for an invalid action, before anything moves.
        """
        return super().step(None if action is None else self.action_type.checked(action, (2,)))

    def _simulate(self, action: NDArray[np.floating] | None = None) -> None:
        """Drive a decision's ticks, or until the episode ends; None keeps the last decision."""
        begin = BEGIN if action is None else BEGIN + SET_ACTION
        self.road.hand_over_objects()
        if self.viewer is None or not self.enable_auto_render:
            self._do(begin + DRIVE + OBSERVE, action)
        else:
            self._simulate_and_render(begin, action)
        self.enable_auto_render = False

    def _simulate_and_render(self, begin: int, action: NDArray[np.floating] | None) -> None:
        """Draw every tick of the decision, so that rendering is as smooth as the simulation."""
        self._do(begin, action)
        for tick in range(self.config["ticks_per_decision"]):
            if tick:
                self._automatic_rendering()
            self._do(TICK)
            if self._is_terminated() or self._is_truncated():
                break
        self._do(OBSERVE)

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

    def _automatic_rendering(self) -> None:
        """Draw a tick within a decision, unless it is for a video that is not being recorded now."""
        if self._record_video_wrapper is None or self._record_video_wrapper.recording:
            super()._automatic_rendering()

    def render(self) -> NDArray[np.uint8] | None:
        """Show the town around the ego: a picture, uint8 [height, width, 3], or a window (`human`)."""
        if self.viewer is None and self.render_mode is not None:
            from athrl_driving.envs.viewer import TownViewer  # only needed for rendering

            self.viewer = TownViewer(self, offscreen=self.config["offscreen_rendering"])
        return super().render()

    def scene(self) -> Scene:
        """The present moment, for a live view or a recording."""
        return self._view.scene()
