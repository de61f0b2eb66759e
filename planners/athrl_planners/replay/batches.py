"""A piece of one episode, and what an update is given: whole sequences, or single transitions.

Actions and rewards are those of the task, in physical units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sequence:
    """A piece of one episode; it never crosses the episode's end.

    It holds one more observation than decisions: `images[length]` is what was seen after the last decision.
    Decisions from `length` on, and observations after `length`, are padding.

    Attributes:
        images: uint8 [time + 1, height, width, channels].
        motion: float32 [time + 1, motion].
        actions: of each level float32 [time, n].
        rewards: of each level float32 [time].
        initial_state: of each level float32 [state], before the first decision; 0 where the episode starts.
        length: decisions that are not padding, 1..time.
        terminated: the episode truly ended with the last decision; false if it only ran out of time.
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
    """Whole sequences, for planners with a memory.

    Attributes:
        images: uint8 [batch, time + 1, height, width, channels].
        motion: float32 [batch, time + 1, motion].
        actions: of each level float32 [batch, time, n].
        rewards: of each level float32 [batch, time].
        initial_state: of each level float32 [batch, state].
        length: int64 [batch].
        terminated: bool [batch].
        places: int64 [batch], where each came from, for its new priority.
        weights: float32 [batch], importance; a mean of 1 or less.
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

    @property
    def transitions(self) -> int:
        """Decisions in the batch that are not padding."""
        return int(self.length.sum())


@dataclass(frozen=True)
class TransitionBatch:
    """Single decisions and what came of them, for planners without a memory.

    What follows a decision is looked at after some numbers of steps, the horizons, or where the sequence ends
    if that is earlier.

    Attributes:
        images: uint8 [1 + horizons, batch, height, width, channels]: at the decision, and after each horizon.
        motion: float32 [1 + horizons, batch, motion] that goes with them.
        actions: of each level float32 [batch, n].
        last_actions: of each level float32 [horizons, batch, n]: the last decision before each horizon.
        rewards: of each level float32 [batch, longest horizon]; 0 behind the sequence's end.
        steps: int64 [horizons, batch], to what each horizon comes.
        terminated: bool [horizons, batch], the episode truly ended within it.
        initial_state: of each level float32 [batch, state], where its sequence begins.
        step: int64 [batch], decisions of the sequence before this one.
        places: int64 [batch], where each came from, for its new priority.
        weights: float32 [batch], importance; a mean of 1 or less.
    """

    images: np.ndarray
    motion: np.ndarray
    actions: dict[str, np.ndarray]
    last_actions: dict[str, np.ndarray]
    rewards: dict[str, np.ndarray]
    steps: np.ndarray
    terminated: np.ndarray
    initial_state: dict[str, np.ndarray]
    step: np.ndarray
    places: np.ndarray
    weights: np.ndarray

    @property
    def transitions(self) -> int:
        """Decisions in the batch."""
        return len(self.step)


Batch = SequenceBatch | TransitionBatch
"""What an update is given."""
