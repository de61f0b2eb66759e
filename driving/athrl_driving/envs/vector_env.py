"""A vector of town environments that one call steps, on several threads."""

from __future__ import annotations

import copy
import numbers
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from athrl_driving.envs.arguments import map_argument, refuse_arguments
from athrl_driving.envs.env_view import EnvView
from athrl_driving.envs.observation import observation_space
from athrl_driving.envs.reset_options import (
    CONFIG,
    RESET_MASK,
    checked_options,
    with_written,
    written_settings,
)
from athrl_driving.envs.settings import (
    changed_settings,
    first_settings,
    new_episodes,
    town_of,
)
from athrl_driving.envs.spec import PlainSpec
from athrl_driving.envs.town_env import TownEnv
from athrl_driving.episode import DECIDE, ObservationArrays, Workers
from athrl_driving.errors import DrivingError
from athrl_driving.scene import Scene

if TYPE_CHECKING:
    from athrl_driving.envs.viewer import BatchViewer

Observations = dict[str, NDArray]

_REMADE = frozenset({"_environments", "_action_type", "_viewer", "_observations"})
"""Attributes that a copy of a vector does not copy."""


class TownVectorEnv(PlainSpec, VectorEnv[Observations, NDArray, NDArray]):
    """`num_envs` towns, each of which does exactly what a `TownEnv` with its seed and its actions would do.

    `config`, `map` and `scenario` are those of `TownEnv`; all environments have the same settings.
    With `render_mode="rgb_array"`, `render` returns a picture of each; there is no window for several.

    `threads`, 1 or more, is the most threads that work at a step, by default the number of cores of the
    process. Each has at least four environments, as with fewer it costs more than it gains; the attribute
    `threads` is the number that work. The results do not depend on it.

    `autoreset_mode` is gymnasium's: an episode that has ended is reset at the next step (NEXT_STEP), within
    the same step (SAME_STEP), or when `reset` is called with `options={"reset_mask": bool [num_envs]}`
    (DISABLED).

    Vectors of several towns may share the memory of `observations` and the threads of `workers`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        map: str | os.PathLike[str] | None = None,
        scenario: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        observations: ObservationArrays | None = None,
        workers: Workers | None = None,
        **others: Any,
    ) -> None:
        refuse_arguments(others, type(self).__init__, TownEnv.default_config())
        if render_mode not in (None, "rgb_array"):
            raise DrivingError(
                f"render_mode is {render_mode!r}, it should be None or 'rgb_array': "
                "many towns have no window in common"
            )
        self.render_mode = render_mode
        self.num_envs = _whole_number("num_envs", num_envs)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self._map = map_argument(map, config)
        self._observations = observations
        self._shares_observations = observations is not None
        self._owns_workers = workers is None
        if workers is None:
            workers = Workers(cores() if threads is None else _whole_number("threads", threads))
        self._workers = workers
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._adopt(changed_settings(first_settings(TownEnv.default_config(), scenario), config, self._map))

    def _adopt(self, settings: dict[str, Any]) -> None:
        """Make the episodes and the spaces for new settings; if that is refused nothing has changed."""
        town = town_of(settings, getattr(self, "_adopted_config", settings), getattr(self, "town", None))
        self.episodes = new_episodes(settings, town, self.num_envs, self._workers, self._observations)
        self.town, self._adopted_config = town, copy.deepcopy(settings)
        self.config = getattr(self, "config", {})  # the same dict, to which somebody may write later
        self.config.update(settings)
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": settings["policy_frequency"],
            "autoreset_mode": self.autoreset_mode,
        }
        self.threads = len(self.episodes.slice_bounds)
        self.single_observation_space = observation_space(settings["image_size"])
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._show()
        self.single_action_space = self._action_type.space()
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._ended = np.zeros(self.num_envs, np.bool_)
        self._begun = np.zeros(self.num_envs, np.bool_)

    def _show(self) -> None:
        """Make the views of the episodes."""
        self._environments = [EnvView(self.episodes, e, self.config) for e in range(self.num_envs)]
        self._action_type = self._environments[0].action_type
        self._viewer: BatchViewer | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs in the same state, in this process or in another; the town by its file.

        A copy has observations and threads of its own. Raises DrivingError while a thread steps.
        """
        return {name: value for name, value in self.__dict__.items() if name not in _REMADE}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the state of another vector, which is independent of this one."""
        self.__dict__.update(state)
        # An array that came from memory between processes may be read only.
        self._ended, self._begun = self._ended.copy(), self._begun.copy()
        self._observations = self.episodes.state.observations if self._shares_observations else None
        self._owns_workers = True
        self._show()

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin new episodes in all environments, or in those of `options["reset_mask"]` bool [num_envs].

        With an integer `seed` environment e has `seed + e`; a list has one for each. Without a seed each
        environment continues with its own random numbers.

        `options["config"]` changes settings of all environments before, so all of them have to be reset; what
        `environment` returned before is then of the past. So does what was written to `config`. Raises
        DrivingError in one line for another option, an unknown setting or an invalid value.
        """
        options = checked_options(options, (CONFIG, RESET_MASK))
        mask = self._reset_mask(options.get(RESET_MASK))
        seeds = self._spread(seed)
        changes = options.get(CONFIG)
        if changes is not None or written_settings(self.config, self._adopted_config):
            self._change_settings(changes, mask)
        for e in np.flatnonzero(mask).tolist():
            if seeds[e] is not None:
                self._generators[e] = seeding.np_random(seeds[e])[0]
        self._begin(mask)
        return self._observe(), self.episodes.infos(mask)

    def step(
        self, actions: NDArray[np.floating]
    ) -> tuple[Observations, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Make one decision in every environment; `actions` are [num_envs, 2] of `single_action_space`.

        Raises DrivingError for invalid actions, before anything moves, and ResetNeeded where an episode
        has not begun, or has ended and is not reset automatically.
        """
        actions = self._checked(actions)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            return self._step_after_reset(actions)
        if self.autoreset_mode == AutoresetMode.DISABLED and self._ended.any():
            ended = np.flatnonzero(self._ended).tolist()
            raise ResetNeeded(f"the episodes of environments {ended} have ended: reset them before the step")
        self._drive(actions, np.ones(self.num_envs, np.bool_))
        results = self._results()
        if self.autoreset_mode == AutoresetMode.DISABLED or not self._ended.any():
            return self._observe(), *results, self._infos()
        return self._reset_within_step(results)

    def step_environments(
        self, actions: NDArray[np.floating], active: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Make one decision in the environments of `active` bool [num_envs] alone, without any autoreset.

        Returns rewards, terminated, truncated and infos of these; the others do not move.
        """
        self.order_step(actions, active)
        self.episodes.drive()
        return self.step_results(active)

    def order_step(self, actions: NDArray, active: NDArray[np.bool_]) -> None:
        """The first half of `step_environments`: workers have to drive the slices of `episodes` next."""
        self._order(self._checked(actions), active)

    def step_results(
        self, active: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """The second half of `step_environments`."""
        self._note_ends()
        rewards, terminated, truncated = self._results()
        return rewards * active, terminated & active, truncated & active, self._infos(active)

    def reset_environment(self, env_index: int, seed: int | None = None) -> None:
        """Begin a new episode in environment `env_index` alone."""
        if seed is not None:
            self._generators[env_index] = seeding.np_random(seed)[0]
        self._begin(np.arange(self.num_envs) == env_index)

    @property
    def images(self) -> NDArray[np.uint8]:
        """uint8 [num_envs, S, S, channels] the last observation; it changes with every step."""
        return self.episodes.state.observations.images

    @property
    def motion(self) -> NDArray[np.float32]:
        """float32 [num_envs, 2] that belongs to `images`."""
        return self.episodes.state.observations.motion

    def environment(self, env_index: int) -> EnvView:
        """Environment `env_index` as an object, for drivers and viewers."""
        return self._environments[env_index]

    def scene(self, env_index: int) -> Scene:
        """The present moment of environment `env_index`."""
        return self._environments[env_index].scene()

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Pictures of all environments, uint8 [height, width, 3] each; None with `render_mode=None`."""
        if self.render_mode is None:
            return None
        if self._viewer is None:
            from athrl_driving.envs.viewer import BatchViewer  # only needed for rendering

            self._viewer = BatchViewer(self._environments)
        return self._viewer.images()

    def close_extras(self, **kwargs: Any) -> None:
        """End the viewer, and the threads unless they are shared: those are closed by who made them."""
        if self._owns_workers:
            self.episodes.close()
        self._viewer = None

    def _step_after_reset(self, actions: NDArray[np.float32]) -> tuple:
        """Step, or reset where the last step ended an episode."""
        ended = self._ended.copy()
        if ended.any():
            self._begin(ended)
        self._drive(actions, ~ended)
        return self._observe(), *self._results(), self._infos()

    def _reset_within_step(self, results: tuple) -> tuple:
        """Reset where the step ended an episode; the final observation goes into the infos."""
        ended = self._ended.copy()
        final_infos = self._infos(ended)
        final = np.full(self.num_envs, None, dtype=object)
        last = self._observe()
        for e in np.flatnonzero(ended).tolist():
            final[e] = {name: values[e] for name, values in last.items()}
        self._begin(ended)
        infos = {
            **self._infos(),
            "final_obs": final,
            "_final_obs": ended.copy(),
            "final_info": final_infos,
            "_final_info": ended,
        }
        return self._observe(), *results, infos

    def _drive(self, actions: NDArray[np.float32], active: NDArray[np.bool_]) -> None:
        self._order(actions, active)
        self.episodes.drive()
        self._note_ends()

    def _order(self, actions: NDArray[np.float32], active: NDArray[np.bool_]) -> None:
        if not self._begun.all():
            missing = np.flatnonzero(active & ~self._begun).tolist()
            if missing:
                raise ResetNeeded(f"no episode has begun in environments {missing}: call reset before step")
        self.episodes.order(active * DECIDE, actions)

    def _note_ends(self) -> None:
        state = self.episodes.state.progress
        np.logical_or(state.terminated, state.truncated, out=self._ended)

    def _begin(self, chosen: NDArray[np.bool_]) -> None:
        env_indices = np.flatnonzero(chosen)
        generators = [self._generator(e) for e in env_indices.tolist()]
        self.episodes.begin(env_indices, generators)
        self._begun[chosen] = True
        self._ended[chosen] = False

    def _observe(self) -> Observations:
        return {"image": self.images.copy(), "motion": self.motion.copy()}

    def _results(self) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        state = self.episodes.state.progress
        return state.reward.copy(), state.terminated.copy(), state.truncated.copy()

    def _infos(self, chosen: NDArray[np.bool_] | None = None) -> dict[str, Any]:
        """The infos of the `chosen` environments, bool [num_envs], with metrics where episodes have ended."""
        chosen = np.ones(self.num_envs, np.bool_) if chosen is None else chosen
        infos = self.episodes.infos(chosen)
        for e in np.flatnonzero(chosen & self._ended).tolist():
            infos = self._add_info(infos, {"metrics": self.episodes.summary(e)}, e)
        return infos

    def _checked(self, actions: NDArray[np.floating]) -> NDArray[np.float32]:
        return self._action_type.checked(actions, (self.num_envs, 2))

    def _change_settings(self, changes: Mapping[str, Any] | None, mask: NDArray[np.bool_]) -> None:
        if not mask.all():
            raise DrivingError(
                "config and reset_mask are given, but all environments have the same settings: "
                "reset all of them to change some"
            )
        adopted = self._adopted_config
        settings = changed_settings(adopted, with_written(changes, self.config, adopted), self._map)
        if self._observations is not None and settings["image_size"] != adopted["image_size"]:
            raise DrivingError(
                f"the setting image_size is {settings['image_size']!r}, it should stay "
                f"{adopted['image_size']!r}: the vector shares the memory of its images"
            )
        self._adopt(settings)

    def _reset_mask(self, mask: Any) -> NDArray[np.bool_]:
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise DrivingError(
                f"reset_mask is {mask!r}, it should be a bool array of {self.num_envs} entries"
            )
        if not mask.any():
            raise DrivingError("reset_mask names no environment, it should name one at least")
        return mask

    def _spread(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (int, np.integer)):
            return [int(seed) + e for e in range(self.num_envs)]
        if not isinstance(seed, (Sequence, np.ndarray)) or isinstance(seed, str):
            raise DrivingError(f"seed is {seed!r}, it should be a whole number or a list of {self.num_envs}")
        if len(seed) != self.num_envs:
            raise DrivingError(
                f"{len(seed)} seeds were given, there should be one for each of {self.num_envs}"
            )
        return [int(each) if isinstance(each, np.integer) else each for each in seed]

    def _generator(self, e: int) -> np.random.Generator:
        generator = self._generators[e]
        if generator is None:
            generator = self._generators[e] = seeding.np_random()[0]
        return generator


def cores() -> int:
    """How many cores the process may use."""
    return len(os.sched_getaffinity(0))


def _whole_number(name: str, value: Any) -> int:
    """Return a number from 1 on; raises DrivingError in one line for anything else."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < 1:
        raise DrivingError(f"{name} is {value!r}, it should be a whole number, 1 or more")
    return int(value)


def _autoreset_mode(value: str | AutoresetMode) -> AutoresetMode:
    """Return gymnasium's mode of that name; raises DrivingError in one line for anything else."""
    try:
        return AutoresetMode(value)
    except ValueError:
        choice = " or ".join(repr(mode.value) for mode in AutoresetMode)
        raise DrivingError(f"autoreset_mode is {value!r}, it should be {choice}") from None
