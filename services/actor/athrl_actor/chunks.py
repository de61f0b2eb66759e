"""Cut one environment's episodes into chunks of a fixed length."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from athrl_protocol import Chunk, LevelColumns

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Transition:
    """One decision of one environment; the arrays may be views, the builder copies them."""

    image: np.ndarray  # uint8 [H, W, C], what the decision was based on
    motion: np.ndarray  # float32 [m]
    states: Arrays  # of each level float32 [s], the recurrent state before the decision
    actions: Arrays  # of each level float32 [n], physical units, noise included
    rewards: Mapping[str, float]  # of each level
    policy_version: int
    next_image: np.ndarray  # uint8 [H, W, C], the terminal observation where the episode ended
    next_motion: np.ndarray  # float32 [m]
    terminated: bool
    truncated: bool


class ChunkBuilder:
    """Collects an environment's transitions; a chunk is full after `time` of them or at the episode's end."""

    def __init__(self, actor: str, incarnation: int, environment: int, time: int) -> None:
        self._actor = actor
        self._incarnation = incarnation
        self._environment = environment
        self._time = time
        self._episode_seed = 0
        self._first_step = 0
        self._columns: _Columns | None = None

    def begin(self, episode_seed: int) -> None:
        """Start a new episode; what is left of the last one must have been taken by `add` or `flush`."""
        if self._columns is not None:
            raise RuntimeError("an episode begins while transitions of the last one are pending")
        self._episode_seed = episode_seed
        self._first_step = 0

    def add(self, transition: Transition) -> Chunk | None:
        """Take the next transition of the episode; returns the chunk that it completes, sequence 0."""
        if self._columns is None:
            self._columns = _Columns.for_first(transition, self._time)
        self._columns.append(transition)
        if self._columns.length == self._time or transition.terminated or transition.truncated:
            return self.flush()
        return None

    def flush(self) -> Chunk | None:
        """Return the transitions so far as a padded chunk, None if there are none; the episode may go on."""
        columns, self._columns = self._columns, None
        if columns is None:
            return None
        chunk = Chunk(
            actor=self._actor,
            incarnation=self._incarnation,
            sequence=0,
            environment=self._environment,
            episode_seed=self._episode_seed,
            first_step=self._first_step,
            length=columns.length,
            images=columns.images,
            motion=columns.motion,
            levels=columns.levels,
            policy_version=columns.policy_version,
            terminated=columns.terminated,
            truncated=columns.truncated,
        )
        self._first_step += columns.length
        return chunk

    def state(self) -> dict[str, Any]:
        """What `load_state` goes on from: where the episode is, and the transitions of the open chunk."""
        columns = self._columns.state() if self._columns is not None else None
        return {"episode_seed": self._episode_seed, "first_step": self._first_step, "columns": columns}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on in the middle of an episode, as the builder was that `state` is of."""
        self._episode_seed, self._first_step = int(state["episode_seed"]), int(state["first_step"])
        self._columns = None if state["columns"] is None else _Columns.of_state(state["columns"])

    def drop(self) -> bool:
        """Forget the transitions since the last chunk; return whether there were any."""
        columns, self._columns = self._columns, None
        return columns is not None


@dataclass
class _Columns:
    """The arrays of a chunk under construction; what is not yet written is the padding, zeros."""

    images: np.ndarray
    motion: np.ndarray
    policy_version: np.ndarray
    levels: dict[str, LevelColumns]
    length: int = 0
    terminated: bool = False
    truncated: bool = False

    @classmethod
    def for_first(cls, first: Transition, time: int) -> _Columns:
        """Columns of `time` rows that fit a transition."""
        return cls(
            images=np.zeros((time + 1, *first.image.shape), np.uint8),
            motion=np.zeros((time + 1, *first.motion.shape), np.float32),
            policy_version=np.zeros(time, np.int64),
            levels={
                level: LevelColumns(
                    actions=np.zeros((time, len(actions)), np.float32),
                    rewards=np.zeros(time, np.float32),
                    initial_state=np.array(first.states[level], np.float32),
                )
                for level, actions in first.actions.items()
            },
        )

    @classmethod
    def of_state(cls, state: Mapping[str, Any]) -> _Columns:
        """Columns as they were when `state` was taken."""
        levels = {name: LevelColumns(**columns) for name, columns in state["levels"].items()}
        return cls(**{**state, "levels": levels})

    def state(self) -> dict[str, Any]:
        """Copies of all arrays and the values beside them, as nested dictionaries."""
        return asdict(self)

    def append(self, transition: Transition) -> None:
        """Write the next row, and the observation after it, which the row after that will overwrite."""
        row = self.length
        self.images[row], self.images[row + 1] = transition.image, transition.next_image
        self.motion[row], self.motion[row + 1] = transition.motion, transition.next_motion
        self.policy_version[row] = transition.policy_version
        self.terminated, self.truncated = transition.terminated, transition.truncated
        for name, level in self.levels.items():
            level.actions[row] = transition.actions[name]
            level.rewards[row] = transition.rewards[name]
        self.length += 1
