"""Many towns at once: a batch of environments that one call steps, on several threads."""

from __future__ import annotations

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

from athrl_driving.envs.observation import observation_space
from athrl_driving.envs.row import TownRow
from athrl_driving.envs.settings import (
    changed_settings,
    first_settings,
    new_episodes,
    refuse_arguments,
    town_of,
)
from athrl_driving.envs.town_env import TownEnv
from athrl_driving.episode import DECIDE, Crew, Sight
from athrl_driving.errors import DrivingError
from athrl_driving.scene import Scene

if TYPE_CHECKING:
    from athrl_driving.envs.viewer import BatchViewer

Observations = dict[str, NDArray]


class TownVectorEnv(VectorEnv[Observations, NDArray, NDArray]):
    """`num_envs` towns, each of which does exactly what a `TownEnv` with its seed and its actions would do.

    `config`, `map` and `scenario` are those of `TownEnv`; the settings are fixed when it is made. With
    `render_mode="rgb_array"`, `render` returns a picture of each; there is no window of many. `threads`,
    from 1 on, is how many work at a step at most, by default as many as the process has cores. Each has at
    least four environments, as fewer cost more than they bring: the attribute `threads` tells how many work.
    The results do not depend on it. `autoreset_mode` is gymnasium's: an
    episode that has ended is reset at the next step (NEXT_STEP), within the same step (SAME_STEP), or when
    `reset` is called with `options={"reset_mask": bool [num_envs]}` (DISABLED). Vectors of
    several towns may have memory for what is seen, `sight`, and the threads of a `crew` in common.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        map: str | None = None,
        scenario: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        sight: Sight | None = None,
        crew: Crew | None = None,
        **others: Any,
    ) -> None:
        refuse_arguments(others)
        if render_mode not in (None, "rgb_array"):
            raise DrivingError(
                f"render_mode is {render_mode!r}, it should be None or 'rgb_array': "
                "many towns have no window in common"
            )
        self.render_mode = render_mode
        self._viewer: BatchViewer | None = None
        self.num_envs = _whole_number("num_envs", num_envs)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.config = changed_settings(first_settings(TownEnv.default_config(), scenario), config, map)
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": self.config["policy_frequency"],
            "autoreset_mode": self.autoreset_mode,
        }
        self.town = town_of(self.config)
        if crew is None:
            crew = Crew(cores() if threads is None else _whole_number("threads", threads))
        self.episodes = new_episodes(self.config, self.town, num_envs, crew, sight)
        self.threads = len(self.episodes.chunks)
        self.single_observation_space = observation_space(self.config["image_size"])
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._rows = [TownRow(self.episodes, e, self.config) for e in range(num_envs)]
        self._action_type = self._rows[0].action_type
        self.single_action_space = self._action_type.space()
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._ended = np.zeros(num_envs, np.bool_)
        self._begun = np.zeros(num_envs, np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin new episodes in all environments, or in those of `options["reset_mask"]` bool [num_envs].

        With an integer `seed` environment e has `seed + e`; a list has one for each. Without one each goes on
        with its own random numbers.
        """
        mask = self._reset_mask(options)
        seeds = self._spread(seed)
        for e in np.flatnonzero(mask).tolist():
            if seeds[e] is not None:
                self._generators[e] = seeding.np_random(seeds[e])[0]
        self._begin(mask)
        return self._observe(), self.episodes.infos(mask)

    def step(
        self, actions: NDArray[np.floating]
    ) -> tuple[Observations, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Make one decision in every environment; `actions` are [num_envs, 2] of `single_action_space`.

        Raises DrivingError for actions that are none, before anything moves, and ResetNeeded where an episode
        has not begun, or has ended and nothing resets it.
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

    def step_rows(
        self, actions: NDArray[np.floating], rows: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Make one decision in the environments of `rows` bool [num_envs] alone, without any autoreset.

        Returns rewards, terminated, truncated and infos of these; the others stand still.
        """
        self.order_rows(actions, rows)
        self.episodes.drive()
        return self.results_of_rows(rows)

    def order_rows(self, actions: NDArray, rows: NDArray[np.bool_]) -> None:
        """The first half of `step_rows`: a crew that drives the pieces of `episodes` has to follow."""
        self._order(self._checked(actions), rows)

    def results_of_rows(
        self, rows: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """The second half of `step_rows`."""
        self._note_ends()
        rewards, terminated, truncated = self._results()
        return rewards * rows, terminated & rows, truncated & rows, self._infos(rows)

    def reset_row(self, e: int, seed: int | None = None) -> None:
        """Begin a new episode in environment `e` alone."""
        if seed is not None:
            self._generators[e] = seeding.np_random(seed)[0]
        self._begin(np.arange(self.num_envs) == e)

    @property
    def images(self) -> NDArray[np.uint8]:
        """uint8 [num_envs, S, S, channels]: what was last seen; it changes with every step."""
        return self.episodes.state.sight.images

    @property
    def motion(self) -> NDArray[np.float32]:
        """float32 [num_envs, 2] that goes with `images`."""
        return self.episodes.state.sight.motion

    def row(self, e: int) -> TownRow:
        """Environment `e` as an object, for drivers and viewers."""
        return self._rows[e]

    def scene(self, e: int) -> Scene:
        """The present moment of environment `e`."""
        return self._rows[e].scene()

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Pictures of all environments, uint8 [height, width, 3] each; None with `render_mode=None`."""
        if self.render_mode is None:
            return None
        if self._viewer is None:
            from athrl_driving.envs.viewer import BatchViewer  # for nobody who renders nothing

            self._viewer = BatchViewer(self._rows)
        return self._viewer.images()

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads and the viewer."""
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
        """Reset where the step ended an episode; what was last seen there goes into the infos."""
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

    def _drive(self, actions: NDArray[np.float32], rows: NDArray[np.bool_]) -> None:
        self._order(actions, rows)
        self.episodes.drive()
        self._note_ends()

    def _order(self, actions: NDArray[np.float32], rows: NDArray[np.bool_]) -> None:
        if not self._begun.all():
            missing = np.flatnonzero(rows & ~self._begun).tolist()
            if missing:
                raise ResetNeeded(f"no episode has begun in environments {missing}: call reset before step")
        self.episodes.order(rows * DECIDE, actions)

    def _note_ends(self) -> None:
        state = self.episodes.state.progress
        np.logical_or(state.terminated, state.truncated, out=self._ended)

    def _begin(self, rows: NDArray[np.bool_]) -> None:
        chosen = np.flatnonzero(rows)
        self.episodes.begin(chosen, [self._generator(e) for e in chosen.tolist()])
        self._begun[rows] = True
        self._ended[rows] = False

    def _observe(self) -> Observations:
        return {"image": self.images.copy(), "motion": self.motion.copy()}

    def _results(self) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        state = self.episodes.state.progress
        return state.reward.copy(), state.terminated.copy(), state.truncated.copy()

    def _infos(self, rows: NDArray[np.bool_] | None = None) -> dict[str, Any]:
        """The infos of `rows`, with the metrics of those whose episodes have ended."""
        rows = np.ones(self.num_envs, np.bool_) if rows is None else rows
        infos = self.episodes.infos(rows)
        for e in np.flatnonzero(rows & self._ended).tolist():
            infos = self._add_info(infos, {"metrics": self.episodes.summary(e)}, e)
        return infos

    def _checked(self, actions: NDArray[np.floating]) -> NDArray[np.float32]:
        return self._action_type.checked(actions, (self.num_envs, 2))

    def _reset_mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        mask = (options or {}).get("reset_mask")
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
        return seed

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
