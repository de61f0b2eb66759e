"""Environments that can be restored by replaying their decisions.

The state of the simulation is not saved: an episode is determined by its seed and its decisions, so these are
enough, and some hundred decisions are replayed within milliseconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from athrl_driving.policy import BatchStep, EnvironmentBatch
from athrl_learner import CannotResume
from athrl_spaces import action_kind


class RepeatableBatch(EnvironmentBatch):
    """A batch of environments that records the seed and the decisions of each episode."""

    def __init__(self, towns: Sequence[str], config: Mapping[str, Any], kind: str, recorded: int) -> None:
        super().__init__(towns, config, kind, recorded)
        self._entries = len(action_kind(kind).entries)
        self._seeds: list[int | None] = [None] * len(towns)  # None before the first episode
        self._decisions: list[list[np.ndarray]] = [[] for _ in towns]

    def reset(self, env_index: int, seed: int) -> None:
        """Start a new episode in one environment."""
        super().reset(env_index, seed)
        self._seeds[env_index] = seed
        self._decisions[env_index] = []

    def step(self, actions: np.ndarray, active: np.ndarray | None = None) -> BatchStep:
        """Step as `EnvironmentBatch`, and record the decisions."""
        for env_index in range(len(self)) if active is None else np.flatnonzero(active).tolist():
            self._decisions[env_index].append(np.array(actions[env_index], np.float32))
        return super().step(actions, active)

    def state(self) -> dict[str, Any]:
        """State for `replay_decisions`: seeds, decisions float32 [n, entries] each, and observations."""
        return {
            "seeds": list(self._seeds),
            "decisions": [
                np.array(decisions, np.float32).reshape(-1, self._entries) for decisions in self._decisions
            ],
            "images": self.images.copy(),
            "motion": self.motion.copy(),
        }

    def replay_decisions(self, state: Mapping[str, Any]) -> None:
        """Restore the state of an earlier batch.

        Raises:
            CannotResume: the observations at the end are not bit for bit the same.
        """
        decisions = state["decisions"]
        for env_index, seed in enumerate(state["seeds"]):
            if seed is not None:
                self.reset(env_index, seed)
        for step in range(max(len(made) for made in decisions)):
            active = np.array([step < len(made) for made in decisions])
            nothing = np.zeros(self._entries, np.float32)
            actions_of_step = [made[step] if step < len(made) else nothing for made in decisions]
            self.step(np.stack(actions_of_step), active)
        for env_index, seed in enumerate(self._seeds):
            if seed is not None:
                self._require_same_observation(env_index, seed, state)

    def _require_same_observation(self, env_index: int, seed: int, state: Mapping[str, Any]) -> None:
        same = all(
            np.array_equal(seen[env_index], state[name][env_index])
            for name, seen in (("images", self.images), ("motion", self.motion))
        )
        if not same:
            raise CannotResume(
                f"environment {env_index}, episode of seed {seed}, is not in its earlier state after "
                f"{len(self._decisions[env_index])} decisions: the checkpoint is of another release, machine "
                "or map"
            )
