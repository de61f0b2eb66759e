"""Environments that come back to where they were, by driving the same decisions again.

The compiled world is not written down: an episode follows from its seed and its decisions, so these are
enough, and some hundred decisions are driven again within milliseconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from athrl_driving.policy import BatchStep, EnvironmentBatch
from athrl_learner import CannotResume
from athrl_spaces import action_kind


class RepeatableBatch(EnvironmentBatch):
    """A batch that knows the seed and the decisions of each environment's episode."""

    def __init__(self, towns: Sequence[str], config: Mapping[str, Any], kind: str, recorded: int) -> None:
        super().__init__(towns, config, kind, recorded)
        self._entries = len(action_kind(kind).entries)
        self._seeds: list[int | None] = [None] * len(towns)  # None: no episode has begun
        self._decisions: list[list[np.ndarray]] = [[] for _ in towns]

    def reset(self, row: int, seed: int) -> None:
        """Begin a new episode in one environment."""
        super().reset(row, seed)
        self._seeds[row] = seed
        self._decisions[row] = []

    def step(self, actions: np.ndarray, active: np.ndarray | None = None) -> BatchStep:
        """Step as `EnvironmentBatch` does, and remember the decisions."""
        for row in range(len(self)) if active is None else np.flatnonzero(active).tolist():
            self._decisions[row].append(np.array(actions[row], np.float32))
        return super().step(actions, active)

    def state(self) -> dict[str, Any]:
        """What `drive_again` needs: seeds, decisions float32 [n, entries] each, what is seen at the end."""
        return {
            "seeds": list(self._seeds),
            "decisions": [
                np.array(decisions, np.float32).reshape(-1, self._entries) for decisions in self._decisions
            ],
            "images": self.images.copy(),
            "motion": self.motion.copy(),
        }

    def drive_again(self, state: Mapping[str, Any]) -> None:
        """Be where the batch was that `state` is of.

        Raises:
            CannotResume: what is seen in the end is not bit for bit what was seen then.
        """
        decisions = state["decisions"]
        for row, seed in enumerate(state["seeds"]):
            if seed is not None:
                self.reset(row, seed)
        for step in range(max(len(made) for made in decisions)):
            active = np.array([step < len(made) for made in decisions])
            nothing = np.zeros(self._entries, np.float32)
            rows = [made[step] if step < len(made) else nothing for made in decisions]
            self.step(np.stack(rows), active)
        for row, seed in enumerate(self._seeds):
            if seed is not None:
                self._require_the_same(row, seed, state)

    def _require_the_same(self, row: int, seed: int, state: Mapping[str, Any]) -> None:
        same = all(
            np.array_equal(seen[row], state[name][row])
            for name, seen in (("images", self.images), ("motion", self.motion))
        )
        if not same:
            raise CannotResume(
                f"environment {row}, episode of seed {seed}, is not where it was after "
                f"{len(self._decisions[row])} decisions: the checkpoint is of another release, machine or map"
            )
