"""Sequences of experience, and batches for updates: whole sequences, or single transitions.

Actions and rewards are in the physical units of the task.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sequence:
    """Consecutive decisions of one episode; a sequence never crosses the end of an episode.

    It has one more observation than decisions: `images[length]` is the observation after the last decision.
    Decisions from `length` on, and observations after `length`, are padding.

    Attributes:
        images: uint8 [time + 1, height, width, channels].
        motion: float32 [time + 1, motion].
        actions: of each level float32 [time, n].
        rewards: of each level float32 [time].
        initial_state: of each level float32 [state], stored state before the first decision; 0 at the start
            of an episode.
        length: decisions that are not padding, 1..time.
        terminated: the episode terminated with the last decision; false if it was truncated.
    """

    images: np.ndarray
    motion: np.ndarray
    actions: dict[str, np.ndarray]
    rewards: dict[str, np.ndarray]
    initial_state: dict[str, np.ndarray]
    length: int
    terminated: bool


@dataclass(frozen=True)
class SequenceBatch:
    """A batch of whole sequences, for planners with a memory.

    Attributes:
        images: uint8 [batch, time + 1, height, width, channels].
        motion: float32 [batch, time + 1, motion].
        actions: of each level float32 [batch, time, n].
        rewards: of each level float32 [batch, time].
        initial_state: of each level float32 [batch, state].
        length: int64 [batch].
        terminated: bool [batch].
        places: int64 [batch], indices in the replay, for new priorities.
        weights: float32 [batch], importance weights, at most 1.
        inserted: sequences that had been inserted into the replay.
    """

    images: np.ndarray
    motion: np.ndarray
    actions: dict[str, np.ndarray]
    rewards: dict[str, np.ndarray]
    initial_state: dict[str, np.ndarray]
    length: np.ndarray
    terminated: np.ndarray
    places: np.ndarray
    weights: np.ndarray
    inserted: int = 0

    @property
    def transitions(self) -> int:
        """Decisions in the batch that are not padding."""
        return int(self.length.sum())


@dataclass(frozen=True)
class Decisions:
    """Single decisions and their outcomes, without the observations.

    The outcome of a decision is observed after some numbers of steps, the horizons, or at the end of the
    sequence if that is earlier.

    Attributes:
        actions: of each level float32 [batch, n].
        last_actions: of each level float32 [horizons, batch, n]: the last decision before each horizon.
        rewards: of each level float32 [batch, longest horizon]; 0 after the end of the sequence.
        steps: int64 [horizons, batch], steps to each horizon.
        terminated: bool [horizons, batch], the episode terminated within the horizon.
        initial_state: of each level float32 [batch, state], stored state at the start of its sequence.
        step: int64 [batch], decisions of the sequence before this one.
        weights: float32 [batch], importance weights, at most 1; 0 of what is not trained.
    """

    actions: dict[str, np.ndarray]
    last_actions: dict[str, np.ndarray]
    rewards: dict[str, np.ndarray]
    steps: np.ndarray
    terminated: np.ndarray
    initial_state: dict[str, np.ndarray]
    step: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True)
class TransitionBatch(Decisions):
    """A batch of single decisions and their outcomes, for planners without a memory.

    Attributes:
        images: uint8 [1 + horizons, batch, height, width, channels]: at the decision, and after each horizon.
        motion: float32 [1 + horizons, batch, motion], at the same times.
        places: int64 [batch], indices in the replay, for new priorities.
        inserted: sequences that had been inserted into the replay.
    """

    images: np.ndarray
    motion: np.ndarray
    places: np.ndarray
    inserted: int = 0

    @property
    def transitions(self) -> int:
        """Decisions in the batch."""
        return len(self.step)


Batch = SequenceBatch | TransitionBatch
"""The input of an update."""
