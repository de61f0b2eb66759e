"""The drivers of an evaluation: a policy artefact, greedily, or one of the reference drivers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from athrl_driving import Driver, make_driver
from athrl_driving.envs import EnvView
from athrl_driving.policy import AnyBatch, OnnxPolicy
from athrl_spaces import WAYPOINT, PolicyDescription
from numpy.typing import NDArray

from athrl_evaluator.scoring.forced_decisions import forced_actions

POLICY_BATCH = 8
"""A policy always runs on this many observations, padded: its sums, and so the episodes, are then the same
for any number of environments."""


@dataclass(frozen=True)
class Decisions:
    """A decision for each environment of a batch.

    Attributes:
        actions: float32 [count, 2] as the environments take them.
        levels: each level's decisions, float32 [count, n], in physical units or as index.
        description: of that policy; None where no policy decided.
    """

    actions: NDArray[np.float32]
    levels: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    description: PolicyDescription | None = None

    def named_values(self, env_index: int) -> dict[str, float]:
        """All decided values of an environment, by name; empty if no policy decided."""
        return {} if self.description is None else self.description.named_values(self.levels, env_index)


class BatchDriver(Protocol):
    """Drives all environments of a batch."""

    name: str
    policy_version: int
    action_kind: str
    """The kind of action that the environments must take."""

    def begin(self, env_index: int, environment: EnvView, seed: int) -> None:
        """An episode has just begun in an environment."""

    def decide(self, batch: AnyBatch, active: NDArray[np.bool_]) -> Decisions:
        """Decide for the environments of `active` bool [count]; the values of the others are ignored."""


class GreedyPolicy:
    """A policy without exploration.

    Args:
        policy: the driver.
        count: of environments.
        policy_version: reported with the results.
        forced: values, by name, that are forced at every decision; they have been checked.
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
        self._padded = -(-count // POLICY_BATCH) * POLICY_BATCH
        self._states = policy.initial_states(self._padded)
        self._forced = forced_actions(policy.description, forced or {}, POLICY_BATCH)

    def begin(self, env_index: int, environment: EnvView, seed: int) -> None:
        """Clear the recurrent states."""
        for state in self._states.values():
            state[env_index] = 0

    def decide(self, batch: AnyBatch, active: NDArray[np.bool_]) -> Decisions:
        """Run the policy over blocks of POLICY_BATCH observations."""
        description, count = self._policy.description, len(batch)
        images = _padded(batch.images, self._padded)
        motion = _padded(batch.motion, self._padded)
        levels = {
            level.name: np.zeros((self._padded, level.action_size), np.float32)
            for level in description.levels
        }
        for start in range(0, self._padded, POLICY_BATCH):
            block = slice(start, start + POLICY_BATCH)
            states = {name: state[block] for name, state in self._states.items()}
            step = self._policy.step(images[block], motion[block], states, forced=self._forced)
            for name, actions in step.actions.items():
                levels[name][block] = actions
            for name, state in step.states.items():
                self._states[name][block] = state
        levels = {name: actions[:count] for name, actions in levels.items()}
        return Decisions(description.environment_action(levels), levels, description)


class ReferenceDriver:
    """One of REFERENCE_DRIVERS, with an instance for each environment."""

    policy_version = 0
    action_kind = WAYPOINT

    def __init__(self, name: str, count: int) -> None:
        self.name = name
        self._drivers: list[Driver] = [make_driver(name) for _ in range(count)]

    def begin(self, env_index: int, environment: EnvView, seed: int) -> None:
        """Begin an episode of the environment's driver."""
        self._drivers[env_index].reset(environment, seed)

    def decide(self, batch: AnyBatch, active: NDArray[np.bool_]) -> Decisions:
        """Ask the driver of each active environment."""
        actions = np.zeros((len(batch), 2), np.float32)
        for env_index in np.flatnonzero(active):
            actions[env_index] = self._drivers[env_index].act(batch.environments[env_index])
        return Decisions(actions)


def _padded(values: NDArray, count: int) -> NDArray:
    padded = np.zeros((count, *values.shape[1:]), values.dtype)
    padded[: len(values)] = values
    return padded
