"""Drive a batch of environments with the newest policy, explore, and cut what happens into chunks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from athrl_driving.envs import TownRow
from athrl_driving.policy import (
    AnyBatch,
    BatchStep,
    ExplorationNoise,
    InvalidPolicy,
    OnnxPolicy,
    PolicyStep,
)
from athrl_protocol import Chunk, PolicyUpdate
from athrl_spaces import PolicyDescription

from athrl_actor.chunks import ChunkCutter
from athrl_actor.seeds import ActorSeeds
from athrl_actor.statistics import DrivingStatistics

MakeBatch = Callable[[str], AnyBatch]
"""Makes the environments for a kind of action, given its name."""


@dataclass(frozen=True)
class Moment:
    """What happened in one environment at one decision, for those who look on."""

    environment: TownRow
    town: str
    image: np.ndarray  # uint8 [H, W, C], after the decision
    policy_version: int
    episode_seed: int
    step: int  # decisions of the episode so far
    decision: dict[str, float]  # everything that was decided, by name
    reward: float
    episode_return: float


@dataclass(frozen=True)
class _Course:
    """What follows from the first policy's description, and stays."""

    description: PolicyDescription
    batch: AnyBatch
    noise: ExplorationNoise
    cutter: ChunkCutter


class Rollout:
    """The environments of an actor with the recurrent states, the noise and the open chunks of each."""

    def __init__(
        self,
        make_batch: MakeBatch,
        environments: int,
        seeds: ActorSeeds,
        *,
        actor: str,
        incarnation: int,
        sequence_length: int,
        sequences: int = 1,
    ) -> None:
        """Nothing is decided before a policy is adopted.

        Args:
            make_batch: called once, when the first policy says which kind of action it decides; the batch
                has `environments` of them and records `sequence_length * sequences` decisions, as many as a
                chunk has at most.
            environments: how many there will be.
            seeds: of this actor.
            actor: its name.
            incarnation: of its process.
            sequence_length: decisions in a sequence.
            sequences: in a chunk at most.
        """
        self.statistics = DrivingStatistics()
        self._make_batch = make_batch
        self._seeds = seeds
        self._actor, self._incarnation = actor, incarnation
        self._sequence_length, self._sequences = sequence_length, sequences
        self._to_begin = list(range(environments))  # environments whose next episode has not begun
        self._episodes = [0] * environments  # begun so far
        self._episode_seeds = [0] * environments
        self._steps = np.zeros(environments, np.int64)
        self._returns = np.zeros(environments)
        self._update: PolicyUpdate | None = None
        self._policy: OnnxPolicy | None = None
        self._begun: _Course | None = None
        self._states: dict[str, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self._steps)

    @property
    def policy_version(self) -> int:
        """The version that decides; -1 before the first one."""
        return -1 if self._update is None else self._update.version

    def adopt(self, update: PolicyUpdate) -> None:
        """Decide with another policy from now on; episodes and recurrent states are continued.

        The first one has the environments made, which takes seconds.

        Raises InvalidPolicy if it cannot be run, or is another kind of policy than the one before.
        """
        policy = OnnxPolicy(update.artefact)
        if self._begun is None:
            self._begun = self._begin(policy)
        elif policy.description != self._begun.description:
            raise InvalidPolicy(
                f"policy {update.version} is of another run than the one before: start the actor again"
            )
        self._policy, self._update = policy, update

    def step(self, on_first_row: Callable[[Moment], None] | None = None) -> list[Chunk]:
        """Make one decision in every environment; returns the chunks that it completed.

        `on_first_row` is told what happened in the first environment. Raises EnvironmentFailure, whose rows
        have to be abandoned; what was decided in this call has not happened then.
        """
        policy, update, course = self._policy, self._update, self._course
        if policy is None or update is None:
            raise RuntimeError("there is no policy yet")
        while self._to_begin:
            self._begin_episode(course, self._to_begin[0])
            del self._to_begin[0]
        decided = self._decide(course, policy, update)
        outcome = course.batch.step(course.description.environment_action(decided.actions))
        self._count(outcome)
        if on_first_row is not None:
            on_first_row(self._moment(course, decided, outcome))
        ended = np.flatnonzero(outcome.terminated | outcome.truncated).tolist()
        chunks = self._cut(decided, {row: bool(outcome.terminated[row]) for row in ended}, update.version)
        self._states = decided.states
        for row in ended:
            collision = bool(outcome.infos["collision"][row])
            self.statistics.episode_ended(course.batch.towns[row], self._returns[row], collision)
            self._to_begin.append(row)
        return chunks

    def abandon(self, rows: Iterable[int]) -> int:
        """Give up the episodes of environments that failed; return how many open chunks are lost with them.

        Their next episodes, with other seeds, begin with the next step.
        """
        given_up = list(rows)
        self._to_begin = sorted({*self._to_begin, *given_up})
        return 0 if self._begun is None else self._begun.cutter.drop(given_up)

    def state(self) -> dict[str, Any]:
        """What `load_state` continues from, beside policy and environments: arrays and plain values."""
        course = self._course
        return {
            "to_begin": list(self._to_begin),
            "episodes": list(self._episodes),
            "episode_seeds": list(self._episode_seeds),
            "steps": self._steps.tolist(),
            "returns": self._returns.copy(),
            "recurrent": {level: state.copy() for level, state in self._states.items()},
            "noise": course.noise.state(),
            "chunks": course.cutter.state(),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Be where the rollout was that `state` is of, before the first step of this one.

        The policy that decided then has been adopted, and the environments are where they were.

        Raises:
            KeyError, TypeError, ValueError: `state` does not fit.
        """
        course = self._course
        course.noise.load_state(state["noise"])
        self._to_begin, self._episodes = list(state["to_begin"]), list(state["episodes"])
        self._episode_seeds = list(state["episode_seeds"])
        self._steps[:], self._returns[:] = state["steps"], state["returns"]
        for level, recurrent in self._states.items():
            recurrent[:] = state["recurrent"][level]
        course.cutter.load_state(state["chunks"])

    def flush(self) -> list[Chunk]:
        """Return what is in the open chunks, padded."""
        return [] if self._begun is None else self._begun.cutter.flush()

    @property
    def _course(self) -> _Course:
        if self._begun is None:
            raise RuntimeError("there is no policy yet")
        return self._begun

    def _begin(self, policy: OnnxPolicy) -> _Course:
        """Make the environments and room for what they do, now that the policy's shape is known."""
        description = policy.description
        batch = self._make_batch(description.action_kind)
        if len(batch) != len(self):
            raise RuntimeError(f"there are {len(batch)} environments, not {len(self)}")
        seen = batch.images.shape[1:]
        if description.observation.image_shape != seen:
            raise InvalidPolicy(
                f"the policy takes images {description.observation.image_shape}, the run's are {seen}"
            )
        self._states = policy.initial_states(len(batch))
        cutter = ChunkCutter(
            self._actor,
            self._incarnation,
            batch=batch,
            environments=len(batch),
            sequence_length=self._sequence_length,
            sequences=self._sequences,
            levels=description.levels,
        )
        noise = ExplorationNoise(description, batch.ranks, self._seeds.exploration())
        return _Course(description, batch, noise, cutter)

    def _begin_episode(self, course: _Course, row: int) -> None:
        seed = self._seeds.episode(row, self._episodes[row])
        self._episodes[row] += 1  # before the reset: a seed with which it fails is not tried again
        course.batch.reset(row, seed)
        course.cutter.begin(row, seed)
        course.noise.reset(row)
        for state in self._states.values():
            state[row] = 0
        self._episode_seeds[row] = seed
        self._steps[row] = 0
        self._returns[row] = 0

    def _decide(self, course: _Course, policy: OnnxPolicy, update: PolicyUpdate) -> PolicyStep:
        noise, batch = course.noise, course.batch
        explored = noise.uniform() if update.uniform_exploration else noise.draw(update.noise_scale)
        return policy.step(batch.images, batch.motion, self._states, explored.noise, explored.forced)

    def _count(self, outcome: BatchStep) -> None:
        self._returns += outcome.rewards
        self._steps += 1
        self.statistics.decided(outcome.infos["speed"])

    def _cut(self, decided: PolicyStep, ended: Mapping[int, bool], version: int) -> list[Chunk]:
        """Gather the decision, with the states before it."""
        return self._course.cutter.add(
            states=self._states, actions=decided.actions, policy_version=version, ended=ended
        )

    def _moment(self, course: _Course, decided: PolicyStep, outcome: BatchStep) -> Moment:
        return Moment(
            environment=course.batch.environments[0],
            town=course.batch.towns[0],
            image=course.batch.images[0],
            policy_version=self.policy_version,
            episode_seed=self._episode_seeds[0],
            step=int(self._steps[0]),
            decision=course.description.named_values(decided.actions, 0),
            reward=float(outcome.rewards[0]),
            episode_return=float(self._returns[0]),
        )
