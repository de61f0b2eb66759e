"""Cut the episodes of a batch of environments into chunks, all environments at once.

Images, motion and rewards are where the simulation has recorded them; what the policy decided is kept here. A
decision costs a few calls for all environments together, everything else is done once a chunk: an actor's
time is for driving.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from athrl_driving.policy import Recording
from athrl_protocol import Chunk, LevelColumns
from athrl_spaces import LevelDescription, places_of_terms

Arrays = Mapping[str, np.ndarray]

LONGEST_SECONDS = 1.0
"""A chunk that is older goes with the sequences that it has: nobody waits for more of a slow actor."""


class Recorded(Protocol):
    """Environments whose last decisions are recorded."""

    @property
    def recording(self) -> Recording:
        """The present one; another one where all episodes have begun anew."""


class ChunkCutter:
    """Collects what happens; an environment's chunk ends with its episode, or when it is full or old.

    All environments decide together, so a decision has the same place in the columns for all of them.

    Args:
        actor: name of the actor.
        incarnation: of its process.
        batch: the environments, which record `sequence_length * sequences` decisions.
        environments: how many there are.
        sequence_length: decisions in a sequence; the recurrent states before each are in the chunk.
        sequences: of which a chunk has so many at most.
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
        """Environments by where a sequence of theirs ends and the next begins, modulo its length."""
        self._phases[0].update(range(environments))
        self._episode_seeds = [0] * environments
        self._first_steps = [0] * environments
        # Twice as long as a chunk, so that they are seldom moved and a chunk's decisions lie together.
        self._policy_version = np.zeros(2 * self._longest, np.int64)
        self._actions = {
            level.name: np.zeros((2 * self._longest, environments, level.action_size), np.float32)
            for level in levels
        }
        self._states = {
            level.name: np.zeros((environments, sequences, level.state_size), np.float32) for level in levels
        }
        self._remembering = [level.name for level in levels if level.state_size]
        self._terms = {level.name: list(places_of_terms(level.rewarded)) for level in levels}

    def begin(self, row: int, episode_seed: int) -> None:
        """Start an episode in one environment, which has been reset.

        What is left of the last one must have been taken by `add`, `flush` or `drop`.
        """
        if self._pending(row):
            raise RuntimeError("an episode begins while transitions of the last one are pending")
        self._episode_seeds[row], self._first_steps[row] = episode_seed, 0
        self._open(row)

    def add(
        self,
        *,
        states: Arrays,
        actions: Arrays,
        policy_version: int,
        ended: Mapping[int, bool],
    ) -> list[Chunk]:
        """Take a decision of every environment, after it was made; the chunks it completes, with sequence 0.

        The arrays are copied.

        Args:
            states: of each level with a memory float32 [batch, s], before the decision.
            actions: of each level float32 [batch, n], physical units, noise included.
            policy_version: that decided.
            ended: environments whose episode the decision ended; False if it only met the time limit.
        """
        if self._place == len(self._policy_version):
            self._move_to_the_front()
        if self._remembering:
            self._keep_states(states)
        for level, column in self._actions.items():
            column[self._place] = actions[level]
        self._policy_version[self._place] = policy_version
        self._place += 1
        complete = {*ended, *self._full_or_old()}
        return [self._take(row, ended.get(row)) for row in sorted(complete)] if complete else []

    def flush(self) -> list[Chunk]:
        """Return the transitions so far as chunks; the episodes may go on."""
        return [self._take(row, None) for row in range(len(self._began)) if self._pending(row)]

    def drop(self, rows: Iterable[int]) -> int:
        """Forget the transitions of some environments since their last chunks; how many chunks that costs."""
        given_up = list(rows)
        dropped = sum(1 for row in given_up if self._pending(row))
        for row in given_up:
            self._open(row)
        return dropped

    def state(self) -> dict[str, Any]:
        """Where the episodes are, and the open chunks: what `load_state` goes on from."""
        return {
            "place": self._place,
            "began": list(self._began),
            "episode_seeds": list(self._episode_seeds),
            "first_steps": list(self._first_steps),
            "recording": self._batch.recording.state(),
            "columns": {name: column.copy() for name, column in self._columns().items()},
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on in the middle of episodes, as the cutter was that `state` is of.

        Raises:
            KeyError, TypeError, ValueError: `state` does not fit.
        """
        self._episode_seeds = [int(seed) for seed in state["episode_seeds"]]
        self._first_steps = [int(step) for step in state["first_steps"]]
        self._batch.recording.load_state(state["recording"])
        for name, column in self._columns().items():
            column[:] = state["columns"][name]
        for row, began in enumerate(state["began"]):
            self._place = int(began)
            self._open(row)
        self._place = int(state["place"])

    def _columns(self) -> dict[str, np.ndarray]:
        """Every array by a name."""
        return {
            "policy_version": self._policy_version,
            **{f"actions/{level}": column for level, column in self._actions.items()},
            **{f"states/{level}": column for level, column in self._states.items()},
        }

    def _pending(self, row: int) -> int:
        """Decisions in the open chunk of an environment."""
        return self._place - self._began[row]

    def _open(self, row: int) -> None:
        """Let an environment's chunk begin here and now."""
        self._phases[self._began[row] % self._interval].discard(row)
        self._phases[self._place % self._interval].add(row)
        self._began[row] = self._place
        self._opened_at[row] = self._clock()

    def _at_a_seam(self) -> set[int]:
        """Environments of which a sequence ends, or begins, here and now."""
        return self._phases[self._place % self._interval]

    def _keep_states(self, states: Arrays) -> None:
        """Keep the states with which a sequence begins."""
        for row in self._at_a_seam():
            number = self._pending(row) // self._interval
            for level in self._remembering:
                self._states[level][row, number] = states[level][row]

    def _full_or_old(self) -> list[int]:
        """Environments whose chunk has no room for another sequence, or has waited for long enough."""
        rows = self._at_a_seam()
        if not rows:
            return []
        full, old = self._place - self._longest, self._clock() - LONGEST_SECONDS
        return [row for row in rows if self._began[row] == full or self._opened_at[row] <= old]

    def _move_to_the_front(self) -> None:
        """Make room behind the decisions of the open chunks."""
        gone = self._longest
        columns: tuple[np.ndarray, ...] = (self._policy_version, *self._actions.values())
        for column in columns:
            column[:gone] = column[gone:]
        self._began = [began - gone for began in self._began]
        self._place -= gone

    def _take(self, row: int, terminated: bool | None) -> Chunk:
        """Return one environment's open chunk, and open the next one with what is seen now.

        `terminated` says of an episode that is over whether it truly ended.
        """
        length = self._pending(row)
        sequences = math.ceil(length / self._interval)
        steps = sequences * self._interval
        places = slice(self._began[row], self._place)
        recording = self._batch.recording
        rewards = self._rewards(recording, row, length, steps)
        chunk = Chunk(
            actor=self._actor,
            incarnation=self._incarnation,
            sequence=0,
            environment=row,
            episode_seed=self._episode_seeds[row],
            first_step=self._first_steps[row],
            length=length,
            state_interval=self._interval,
            images=_padded(recording.images[row, : length + 1], steps + 1),
            motion=_padded(recording.motion[row, : length + 1], steps + 1),
            levels={
                level: LevelColumns(
                    actions=_padded(actions[places, row], steps),
                    rewards=rewards[level],
                    states=self._states[level][row, :sequences].copy(),
                )
                for level, actions in self._actions.items()
            },
            policy_version=_padded(self._policy_version[places], steps),
            terminated=terminated is True,
            truncated=terminated is False,
        )
        recording.rewind(row, length)
        self._first_steps[row] += length
        self._open(row)
        return chunk

    def _rewards(self, recording: Recording, row: int, length: int, steps: int) -> dict[str, np.ndarray]:
        """What each level is paid for one environment's last `length` decisions, float32 [steps].

        Levels that are paid the task's reward have the same array.
        """
        of_the_task = _padded(recording.rewards[row, 1 : length + 1], steps)
        terms = recording.terms[row, 1 : length + 1]
        return {
            level: _padded(terms[:, places].sum(axis=1), steps) if places else of_the_task
            for level, places in self._terms.items()
        }


def _padded(column: np.ndarray, rows: int) -> np.ndarray:
    """A copy of a column with zeros behind it, `rows` in all."""
    copy = np.empty((rows, *column.shape[1:]), column.dtype)
    copy[: len(column)] = column
    if len(column) < rows:
        copy[len(column) :] = 0
    return copy
