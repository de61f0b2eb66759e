"""Who drives in an evaluation: a policy artefact, greedily, or one of the reference drivers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from athrl_driving import Driver, make_driver
from athrl_driving.envs import TownRow
from athrl_driving.policy import AnyBatch, OnnxPolicy

REFERENCE_DRIVERS = ("random", "blind", "rule-based")

POLICY_ROWS = 8
"""A policy always runs on this many rows, padded: the sums inside, and so the episodes, are then the same
whatever the number of environments is."""


@dataclass(frozen=True)
class Decisions:
    """A decision for each row: actions float32 [count, 2] in [-1, 1], intention float32 [count] or NaN."""

    actions: np.ndarray
    intention: np.ndarray


class BatchDriver(Protocol):
    """Drives all environments of a batch."""

    name: str
    policy_version: int

    def begin(self, row: int, environment: TownRow, seed: int) -> None:
        """An episode has just begun in a row."""

    def decide(self, batch: AnyBatch, active: np.ndarray) -> Decisions:
        """Decide for the rows of `active` bool [count]; the other rows' values are ignored."""


class GreedyPolicy:
    """A policy without exploration noise."""

    name = "policy"

    def __init__(self, policy: OnnxPolicy, count: int, policy_version: int = 0) -> None:
        self.policy_version = policy_version
        self._policy = policy
        self._padded = -(-count // POLICY_ROWS) * POLICY_ROWS
        self._states = policy.initial_states(self._padded)

    def begin(self, row: int, environment: TownRow, seed: int) -> None:
        """Forget the last episode."""
        for state in self._states.values():
            state[row] = 0

    def decide(self, batch: AnyBatch, active: np.ndarray) -> Decisions:
        """Run the policy over blocks of POLICY_ROWS rows."""
        metadata, count = self._policy.metadata, len(batch)
        images = _padded(batch.images, self._padded)
        motion = _padded(batch.motion, self._padded)
        actions = np.zeros((self._padded, metadata.acting_level.action_size), np.float32)
        intention = np.full(self._padded, np.nan, np.float32)
        for start in range(0, self._padded, POLICY_ROWS):
            rows = slice(start, start + POLICY_ROWS)
            states = {name: state[rows] for name, state in self._states.items()}
            step = self._policy.step(images[rows], motion[rows], states)
            actions[rows] = metadata.acting_level.normalised(step.actions[metadata.acting_level.name])
            if "intention" in step.actions:
                intention[rows] = step.actions["intention"][:, 0]
            for name, state in step.states.items():
                self._states[name][rows] = state
        return Decisions(actions[:count], intention[:count])


class ReferenceDriver:
    """One of REFERENCE_DRIVERS, an own one for each row."""

    policy_version = 0

    def __init__(self, name: str, count: int) -> None:
        self.name = name
        self._drivers: list[Driver] = [make_driver(name) for _ in range(count)]

    def begin(self, row: int, environment: TownRow, seed: int) -> None:
        """Begin the row's driver's episode."""
        self._drivers[row].reset(environment, seed)

    def decide(self, batch: AnyBatch, active: np.ndarray) -> Decisions:
        """Ask the driver of each active row."""
        actions = np.zeros((len(batch), 2), np.float32)
        for row in np.flatnonzero(active):
            actions[row] = self._drivers[row].act(batch.environments[row])
        return Decisions(actions, np.full(len(batch), np.nan, np.float32))


def _padded(rows: np.ndarray, count: int) -> np.ndarray:
    padded = np.zeros((count, *rows.shape[1:]), rows.dtype)
    padded[: len(rows)] = rows
    return padded
