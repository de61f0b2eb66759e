"""A piece of one episode, and a batch of them, as NumPy columns.

Both hold one more observation than decisions: `images[length]` is what was seen after the last decision.
Decisions from `length` on, and observations after `length`, are padding. Actions and rewards are in physical
units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sequence:
    """A piece of one episode; it never crosses the episode's end."""

    images: np.ndarray  # uint8 [time + 1, height, width, channels]
    motion: np.ndarray  # float32 [time + 1, motion]
    actions: dict[str, np.ndarray]  # per level: float32 [time, n]
    rewards: dict[str, np.ndarray]  # per level: float32 [time]
    initial_state: dict[
        str, np.ndarray
    ]  # per level: float32 [state], before the first decision; 0 where it starts
    length: int  # decisions that are not padding, 1..time
    terminated: bool  # the episode truly ended with the last decision; false if it only ran out of time


@dataclass(frozen=True)
class SequenceBatch:
    """Sequences of equal time, ready for an update."""

    images: np.ndarray  # uint8 [batch, time + 1, height, width, channels]
    motion: np.ndarray  # float32 [batch, time + 1, motion]
    actions: dict[str, np.ndarray]  # per level: float32 [batch, time, n]
    rewards: dict[str, np.ndarray]  # per level: float32 [batch, time]
    initial_state: dict[str, np.ndarray]  # per level: float32 [batch, state]
    length: np.ndarray  # int64 [batch]
    terminated: np.ndarray  # bool [batch]

    @property
    def transitions(self) -> int:
        """Decisions in the batch that are not padding."""
        return int(self.length.sum())
