"""Cuts the episodes of a batch of environments into chunks, all environments at once.

Images, motion and rewards are read from the simulation's recording; the policy's decisions are kept here. A
decision costs a few calls for all environments together; everything else is done once per chunk, because an
actor's time is for driving.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from athrl_driving.policy import Recording
from athrl_protocol import Chunk, LevelColumns
from athrl_spaces import LevelDescription, indices_of_terms

Arrays = Mapping[str, np.ndarray]

LONGEST_SECONDS = 1.0
"""Age at which a chunk is sent with the sequences that it has, so that slow actors' data is not late."""


class Recorded(Protocol):
    """Environments whose last decisions are recorded."""

    @property
    def recording(self) -> Recording:
        """The present recording; a new one if the environments have been replaced."""


class ChunkCutter:
    """Collects decisions; an environment's chunk ends with its episode, or when it is full or old.

    All environments decide together, so a decision has the same index in the columns of all of them.

    Args:
        actor: name of the actor.
        incarnation: of its process.
        batch: the environments, which record `sequence_length * sequences` decisions.
        environments: how many there are.
        sequence_length: decisions in a sequence; the recurrent states before each are in the chunk.
        sequences: the most sequences in a chunk.
        levels: of the planner, from the highest down.
        clock: seconds, for `LONGEST_SECONDS`.
    """

    def __init__(
        self,
        actor: str,
        incarnation: int,
        *,
        batch: Recorded,
        environments: int,
        sequence_length: int,
        sequences: int,
        levels: Sequence[LevelDescription],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._actor, self._incarnation = actor, incarnation
        self._batch = batch
        self._interval, self._longest = sequence_length, sequence_length * sequences
        self._clock = clock
        self._place = 0  # of the next decision in the columns
        self._began = [0] * environments  # places of the open chunks' first decisions
        self._opened_at = [clock()] * environments
        self._phases: list[set[int]] = [set() for _ in range(sequence_length)]
        """Environments by the index at which a sequence ends and the next begins, modulo its length."""
        self._phases[0].update(range(environments))
        self._episode_seeds = [0] * environments
        self._first_steps = [0] * environments
        # Twice as long as a chunk, so that they are seldom moved and a chunk's decisions are contiguous.
        self._policy_version = np.zeros(2 * self._longest, np.int64)
        self._actions = {
            level.name: np.zeros((2 * self._longest, environments, level.action_size), np.float32)
            for level in levels
        }
        self._states = {
            level.name: np.zeros((environments, sequences, level.state_size), np.float32) for level in levels
        }
        self._recurrent = [level.name for level in levels if level.state_size]
        self._terms = {level.name: list(indices_of_terms(level.rewarded)) for level in levels}

    def begin(self, env_index: int, episode_seed: int) -> None:
        """Start an episode in one environment, which has been reset.

        The last episode's transitions must have been taken by `add`, `flush` or `drop`.
        """
        if self._pending(env_index):
            raise RuntimeError("an episode begins while transitions of the last one are pending")
        self._episode_seeds[env_index], self._first_steps[env_index] = episode_seed, 0
        self._open(env_index)

    def add(
        self,
        *,
        states: Arrays,
        actions: Arrays,
        policy_version: int,
        ended: Mapping[int, bool],
    ) -> list[Chunk]:
        """Add a decision of every environment after it was made; return completed chunks, with sequence 0.

        The arrays are copied.

        Args:
            states: of each level with a memory float32 [batch, s], before the decision.
            actions: of each level float32 [batch, n], physical units, noise included.
            policy_version: that decided.
            ended: environments whose episode the decision ended; False if it was only truncated.
        """
        if self._place == len(self._policy_version):
            self._move_to_front()
        if self._recurrent:
            self._keep_states(states)
        for level, column in self._actions.items():
            column[self._place] = actions[level]
        self._policy_version[self._place] = policy_version
        self._place += 1
        complete = {*ended, *self._full_or_old()}
        return [self._take(e, ended.get(e)) for e in sorted(complete)] if complete else []

    @property
    def open_decisions(self) -> int:
        """Decisions in the open chunks of all environments."""
        return sum(map(self._pending, range(len(self._began))))

    def flush(self) -> list[Chunk]:
        """Return the transitions so far as chunks; the episodes may continue."""
        return [self._take(e, None) for e in range(len(self._began)) if self._pending(e)]

    def drop(self, env_indices: Iterable[int]) -> int:
        """Drop some environments' transitions since their last chunks; return how many chunks are lost."""
        given_up = list(env_indices)
        dropped = sum(1 for e in given_up if self._pending(e))
        for env_index in given_up:
            self._open(env_index)
        return dropped

    def state(self) -> dict[str, Any]:
        """The state for `load_state`: the progress of the episodes and the open chunks."""
        return {
            "place": self._place,
            "began": list(self._began),
            "episode_seeds": list(self._episode_seeds),
            "first_steps": list(self._first_steps),
            "recording": self._batch.recording.state(),
            "columns": {name: column.copy() for name, column in self._columns().items()},
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue in the middle of episodes, like the cutter that `state` was taken from.

        Raises:
            KeyError, TypeError, ValueError: `state` does not fit.
        """
        self._episode_seeds = [int(seed) for seed in state["episode_seeds"]]
        self._first_steps = [int(step) for step in state["first_steps"]]
        self._batch.recording.load_state(state["recording"])
        for name, column in self._columns().items():
            column[:] = state["columns"][name]
        for env_index, began in enumerate(state["began"]):
            self._place = int(began)
            self._open(env_index)
        self._place = int(state["place"])

    def _columns(self) -> dict[str, np.ndarray]:
        """All arrays by name."""
        return {
            "policy_version": self._policy_version,
            **{f"actions/{level}": column for level, column in self._actions.items()},
            **{f"states/{level}": column for level, column in self._states.items()},
        }

    def _pending(self, env_index: int) -> int:
        """Decisions in the open chunk of an environment."""
        return self._place - self._began[env_index]

    def _open(self, env_index: int) -> None:
        """Start an environment's chunk at the present index."""
        self._phases[self._began[env_index] % self._interval].discard(env_index)
        self._phases[self._place % self._interval].add(env_index)
        self._began[env_index] = self._place
        self._opened_at[env_index] = self._clock()

    def _at_sequence_boundary(self) -> set[int]:
        """Environments in which a sequence ends or begins at the present index."""
        return self._phases[self._place % self._interval]

    def _keep_states(self, states: Arrays) -> None:
        """Store the states at the beginning of a sequence."""
        for env_index in self._at_sequence_boundary():
            number = self._pending(env_index) // self._interval
            for level in self._recurrent:
                self._states[level][env_index, number] = states[level][env_index]

    def _full_or_old(self) -> list[int]:
        """Environments whose chunk is full or has reached its maximum age."""
        candidates = self._at_sequence_boundary()
        if not candidates:
            return []
        full, old = self._place - self._longest, self._clock() - LONGEST_SECONDS
        return [e for e in candidates if self._began[e] == full or self._opened_at[e] <= old]

    def _move_to_front(self) -> None:
        """Move the decisions of the open chunks to the front to make room after them."""
        gone = self._longest
        columns: tuple[np.ndarray, ...] = (self._policy_version, *self._actions.values())
        for column in columns:
            column[:gone] = column[gone:]
        self._began = [began - gone for began in self._began]
        self._place -= gone

    def _take(self, env_index: int, terminated: bool | None) -> Chunk:
        """Return one environment's open chunk, and open the next one with the present observation.

        `terminated`: whether an ended episode was terminated rather than truncated; None: it continues.
        """
        length = self._pending(env_index)
        sequences = math.ceil(length / self._interval)
        steps = sequences * self._interval
        places = slice(self._began[env_index], self._place)
        recording = self._batch.recording
        rewards = self._rewards(recording, env_index, length, steps)
        chunk = Chunk(
            actor=self._actor,
            incarnation=self._incarnation,
            sequence=0,
            environment=env_index,
            episode_seed=self._episode_seeds[env_index],
            first_step=self._first_steps[env_index],
            length=length,
            state_interval=self._interval,
            images=_padded(recording.images[env_index, : length + 1], steps + 1),
            motion=_padded(recording.motion[env_index, : length + 1], steps + 1),
            levels={
                level: LevelColumns(
                    actions=_padded(actions[places, env_index], steps),
                    rewards=rewards[level],
                    states=self._states[level][env_index, :sequences].copy(),
                )
                for level, actions in self._actions.items()
            },
            policy_version=_padded(self._policy_version[places], steps),
            terminated=terminated is True,
            truncated=terminated is False,
        )
        recording.rewind(env_index, length)
        self._first_steps[env_index] += length
        self._open(env_index)
        return chunk

    def _rewards(
        self, recording: Recording, env_index: int, length: int, steps: int
    ) -> dict[str, np.ndarray]:
        """The reward of each level for one environment's last `length` decisions, float32 [steps].

        Levels that receive the task's reward share one array.
        """
        task_rewards = _padded(recording.rewards[env_index, 1 : length + 1], steps)
        terms = recording.terms[env_index, 1 : length + 1]
        return {
            level: _padded(terms[:, places].sum(axis=1), steps) if places else task_rewards
            for level, places in self._terms.items()
        }


def _padded(column: np.ndarray, length: int) -> np.ndarray:
    """Return a copy of a column with zeros appended, `length` entries in all."""
    copy = np.empty((length, *column.shape[1:]), column.dtype)
    copy[: len(column)] = column
    if len(column) < length:
        copy[len(column) :] = 0
    return copy
