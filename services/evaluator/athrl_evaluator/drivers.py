"""Who drives in an evaluation: a policy artefact, greedily, or one of the reference drivers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from athrl_driving import Driver, make_driver
from athrl_driving.envs import TownRow
from athrl_driving.policy import AnyBatch, OnnxPolicy
from athrl_spaces import WAYPOINT, PolicyDescription
from numpy.typing import NDArray

from athrl_evaluator.forcing import forced_actions

REFERENCE_DRIVERS = ("random", "blind", "rule-based")

POLICY_ROWS = 8
"""A policy always runs on this many rows, padded: the sums inside, and so the episodes, are then the same
whatever the number of environments is."""


@dataclass(frozen=True)
class Decisions:
    """A decision for each row of a batch.

    Attributes:
        actions: float32 [count, 2] as the environments take them.
        levels: what each level of a policy decided, float32 [count, n], physical units or index.
        description: of that policy; None where no policy decided.
    """

    actions: NDArray[np.float32]
    levels: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    description: PolicyDescription | None = None

    def named_values(self, row: int) -> dict[str, float]:
        """Everything that was decided for a row, by name; nothing where no policy decided."""
        return {} if self.description is None else self.description.named_values(self.levels, row)


class BatchDriver(Protocol):
    """Drives all environments of a batch."""

    name: str
    policy_version: int
    action_kind: str
    """What the environments have to take."""

    def begin(self, row: int, environment: TownRow, seed: int) -> None:
        """An episode has just begun in a row."""

    def decide(self, batch: AnyBatch, active: NDArray[np.bool_]) -> Decisions:
        """Decide for the rows of `active` bool [count]; the other rows' values are ignored."""


class GreedyPolicy:
    """A policy without exploration.

    Args:
        policy: which drives.
        count: of environments.
        policy_version: told with what it does.
        forced: values, by name, that it has to decide all the time; they have been checked.
    """

    name = "policy"

    def __init__(
        self,
        policy: OnnxPolicy,
        count: int,
        policy_version: int = 0,
        forced: Mapping[str, float] | None = None,
    ) -> None:
        self.policy_version = policy_version
        self.action_kind = policy.description.action_kind
        self._policy = policy
        self._padded = -(-count // POLICY_ROWS) * POLICY_ROWS
        self._states = policy.initial_states(self._padded)
        self._forced = forced_actions(policy.description, forced or {}, POLICY_ROWS)

    def begin(self, row: int, environment: TownRow, seed: int) -> None:
        """Forget the last episode."""
        for state in self._states.values():
            state[row] = 0

    def decide(self, batch: AnyBatch, active: NDArray[np.bool_]) -> Decisions:
        """Run the policy over blocks of POLICY_ROWS rows."""
        description, count = self._policy.description, len(batch)
        images = _padded(batch.images, self._padded)
        motion = _padded(batch.motion, self._padded)
        levels = {
            level.name: np.zeros((self._padded, level.action_size), np.float32)
            for level in description.levels
        }
        for start in range(0, self._padded, POLICY_ROWS):
            rows = slice(start, start + POLICY_ROWS)
            states = {name: state[rows] for name, state in self._states.items()}
            step = self._policy.step(images[rows], motion[rows], states, forced=self._forced)
            for name, actions in step.actions.items():
                levels[name][rows] = actions
            for name, state in step.states.items():
                self._states[name][rows] = state
        levels = {name: actions[:count] for name, actions in levels.items()}
        return Decisions(description.environment_action(levels), levels, description)


class ReferenceDriver:
    """One of REFERENCE_DRIVERS, an own one for each row."""

    policy_version = 0
    action_kind = WAYPOINT

    def __init__(self, name: str, count: int) -> None:
        self.name = name
        self._drivers: list[Driver] = [make_driver(name) for _ in range(count)]

    def begin(self, row: int, environment: TownRow, seed: int) -> None:
        """Begin the row's driver's episode."""
        self._drivers[row].reset(environment, seed)

    def decide(self, batch: AnyBatch, active: NDArray[np.bool_]) -> Decisions:
        """Ask the driver of each active row."""
        actions = np.zeros((len(batch), 2), np.float32)
        for row in np.flatnonzero(active):
            actions[row] = self._drivers[row].act(batch.environments[row])
        return Decisions(actions)


def _padded(rows: NDArray, count: int) -> NDArray:
    padded = np.zeros((count, *rows.shape[1:]), rows.dtype)
    padded[: len(rows)] = rows
    return padded
