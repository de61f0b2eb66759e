"""Cut the episodes of a batch of environments into chunks of a fixed length, all environments at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from athrl_protocol import Chunk, LevelColumns

Arrays = Mapping[str, np.ndarray]


class ChunkCutter:
    """Collects what happens; an environment's chunk is full after `time` decisions or at its episode's end.

    The columns of the open chunks are arrays over all environments, written where each one is. Row `length`
    of the observations is always the present one: the next decision's, or what the last one led to.

    Args:
        actor: name of the actor.
        incarnation: of its process.
        time: decisions in a chunk.
        image_shape: height, width, channels.
        motion_size: numbers beside the image.
        levels: action size and state size of each level, by name from the highest down.
        environments: how many.
    """

    def __init__(
        self,
        actor: str,
        incarnation: int,
        *,
        time: int,
        image_shape: tuple[int, ...],
        motion_size: int,
        levels: Mapping[str, tuple[int, int]],
        environments: int,
    ) -> None:
        self._actor = actor
        self._incarnation = incarnation
        self._time = time
        self._rows = np.arange(environments)
        self._length = np.zeros(environments, np.int64)
        self._episode_seeds = [0] * environments
        self._first_steps = [0] * environments
        self._images = np.zeros((environments, time + 1, *image_shape), np.uint8)
        self._motion = np.zeros((environments, time + 1, motion_size), np.float32)
        self._policy_version = np.zeros((environments, time), np.int64)
        self._rewards = {level: np.zeros((environments, time), np.float32) for level in levels}
        self._actions = {
            level: np.zeros((environments, time, actions), np.float32)
            for level, (actions, _) in levels.items()
        }
        self._initial_states = {
            level: np.zeros((environments, state), np.float32) for level, (_, state) in levels.items()
        }

    def begin(self, row: int, episode_seed: int, image: np.ndarray, motion: np.ndarray) -> None:
        """Start an episode in one environment, which is seen as `image` [H, W, C] and `motion` [m].

        What is left of the last one must have been taken by `add`, `flush` or `drop`.
        """
        if self._length[row]:
            raise RuntimeError("an episode begins while transitions of the last one are pending")
        self._episode_seeds[row], self._first_steps[row] = episode_seed, 0
        self._images[row, 0], self._motion[row, 0] = image, motion

    def add(
        self,
        *,
        states: Arrays,
        actions: Arrays,
        rewards: Arrays,
        policy_version: int,
        images: np.ndarray,
        motion: np.ndarray,
        terminated: np.ndarray,
        truncated: np.ndarray,
    ) -> list[Chunk]:
        """Take a decision of every environment; returns the chunks that it completes, with sequence 0.

        The arrays are copied.

        Args:
            states: of each level float32 [batch, s], the recurrent state before the decision.
            actions: of each level float32 [batch, n], physical units, noise included.
            rewards: of each level float32 [batch].
            policy_version: that decided.
            images: uint8 [batch, H, W, C], what the decision led to; terminal where the episode ended.
            motion: float32 [batch, m], likewise.
            terminated: bool [batch], the decision ended the episode.
            truncated: bool [batch], it met the time limit.
        """
        rows, at = self._rows, self._length
        first = np.flatnonzero(at == 0)
        if first.size:
            for level, initial in self._initial_states.items():
                initial[first] = states[level][first]
        for level, column in self._actions.items():
            column[rows, at] = actions[level]
            self._rewards[level][rows, at] = rewards[level]
        self._policy_version[rows, at] = policy_version
        at += 1
        self._images[rows, at] = images
        self._motion[rows, at] = motion
        full = np.flatnonzero((at == self._time) | terminated | truncated)
        return [self._take(row, bool(terminated[row]), bool(truncated[row])) for row in full.tolist()]

    def flush(self) -> list[Chunk]:
        """Return the transitions so far as padded chunks; the episodes may go on."""
        return [self._take(row, False, False) for row in np.flatnonzero(self._length).tolist()]

    def drop(self, rows: Iterable[int]) -> int:
        """Forget the transitions of some environments since their last chunks; how many chunks that costs."""
        given_up = list(rows)
        dropped = int(np.count_nonzero(self._length[given_up]))
        self._length[given_up] = 0
        return dropped

    def state(self) -> dict[str, Any]:
        """Where the episodes are, and the open chunks: what `load_state` goes on from."""
        return {
            "episode_seeds": list(self._episode_seeds),
            "first_steps": list(self._first_steps),
            "columns": {name: column.copy() for name, column in self._columns().items()},
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on in the middle of episodes, as the cutter was that `state` is of.

        Raises:
            KeyError, TypeError, ValueError: `state` does not fit.
        """
        self._episode_seeds = [int(seed) for seed in state["episode_seeds"]]
        self._first_steps = [int(step) for step in state["first_steps"]]
        for name, column in self._columns().items():
            column[:] = state["columns"][name]

    def _columns(self) -> dict[str, np.ndarray]:
        """Every array by a name."""
        columns: dict[str, np.ndarray] = {
            "length": self._length,
            "images": self._images,
            "motion": self._motion,
            "policy_version": self._policy_version,
        }
        of_levels: dict[str, dict[str, np.ndarray]] = {
            "actions": self._actions,
            "rewards": self._rewards,
            "initial_states": self._initial_states,
        }
        for kind, levels in of_levels.items():
            columns |= {f"{kind}/{level}": column for level, column in levels.items()}
        return columns

    def _take(self, row: int, terminated: bool, truncated: bool) -> Chunk:
        """Return one environment's open chunk, and open the next one with what is seen now."""
        length = int(self._length[row])
        chunk = Chunk(
            actor=self._actor,
            incarnation=self._incarnation,
            sequence=0,
            environment=row,
            episode_seed=self._episode_seeds[row],
            first_step=self._first_steps[row],
            length=length,
            images=_padded(self._images[row], length + 1),
            motion=_padded(self._motion[row], length + 1),
            levels={
                level: LevelColumns(
                    actions=_padded(actions[row], length),
                    rewards=_padded(self._rewards[level][row], length),
                    initial_state=self._initial_states[level][row].copy(),
                )
                for level, actions in self._actions.items()
            },
            policy_version=_padded(self._policy_version[row], length),
            terminated=terminated,
            truncated=truncated,
        )
        self._first_steps[row] += length
        self._images[row, 0], self._motion[row, 0] = self._images[row, length], self._motion[row, length]
        self._length[row] = 0
        return chunk


def _padded(column: np.ndarray, valid: int) -> np.ndarray:
    """A copy of a column with zeros from row `valid` on."""
    copy = column.copy()
    copy[valid:] = 0
    return copy
