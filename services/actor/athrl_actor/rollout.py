"""Drives a batch of environments with the newest policy, explores, and cuts the experience into chunks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from athrl_driving.envs import EnvView
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
    """The result of one decision in one environment, for live viewing."""

    environment: EnvView
    town: str
    image: np.ndarray  # uint8 [H, W, C], after the decision
    policy_version: int
    episode_seed: int
    step: int  # decisions of the episode so far
    decision: dict[str, float]  # everything that was decided, by name
    reward: float
    episode_return: float


@dataclass(frozen=True)
class _Setup:
    """What is fixed by the first policy's description."""

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
        """A policy has to be adopted before the first step.

        Args:
            make_batch: called once, when the first policy determines the kind of action; the batch has
                `environments` environments and records `sequence_length * sequences` decisions, the most in
                a chunk.
            environments: their number.
            seeds: of this actor.
            actor: its name.
            incarnation: of its process.
            sequence_length: decisions in a sequence.
            sequences: the most in a chunk.
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
        self._prepared: _Setup | None = None
        self._states: dict[str, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self._steps)

    @property
    def policy_version(self) -> int:
        """The version that decides; -1 before the first one."""
        return -1 if self._update is None else self._update.version

    def adopt(self, update: PolicyUpdate) -> None:
        """Decide with another policy from now on; episodes and recurrent states continue.

        The first policy makes the environments, which takes seconds.

        Raises InvalidPolicy if it cannot be run, or has another description than the one before.
        """
        policy = OnnxPolicy(update.artefact)
        if self._prepared is None:
            self._prepared = self._prepare(policy)
        elif policy.description != self._prepared.description:
            raise InvalidPolicy(
                f"policy {update.version} is of another run than the one before: restart the actor"
            )
        self._policy, self._update = policy, update

    def step(self, on_first_environment: Callable[[Moment], None] | None = None) -> list[Chunk]:
        """Make one decision in every environment; returns the chunks that it completed.

        `on_first_environment` is called with the first environment's moment. Raises EnvironmentFailure; its
        environments have to be abandoned, and the decisions of this call have not been made.
        """
        policy, update, setup = self._policy, self._update, self._setup
        if policy is None or update is None:
            raise RuntimeError("there is no policy yet")
        while self._to_begin:
            self._begin_episode(setup, self._to_begin[0])
            del self._to_begin[0]
        decided = self._decide(setup, policy, update)
        outcome = setup.batch.step(setup.description.environment_action(decided.actions))
        self._count(outcome)
        if on_first_environment is not None:
            on_first_environment(self._moment(setup, decided, outcome))
        ended = np.flatnonzero(outcome.terminated | outcome.truncated).tolist()
        chunks = self._cut(decided, {e: bool(outcome.terminated[e]) for e in ended}, update.version)
        self._states = decided.states
        for env_index in ended:
            collision = bool(outcome.infos["collision"][env_index])
            self.statistics.episode_ended(setup.batch.towns[env_index], self._returns[env_index], collision)
            self._to_begin.append(env_index)
        return chunks

    def abandon(self, env_indices: Iterable[int]) -> int:
        """Give up the episodes of environments that failed; return how many open chunks are lost.

        Their next episodes, with other seeds, begin with the next step.
        """
        given_up = list(env_indices)
        self._to_begin = sorted({*self._to_begin, *given_up})
        return 0 if self._prepared is None else self._prepared.cutter.drop(given_up)

    def state(self) -> dict[str, Any]:
        """The state for `load_state`, without policy and environments: arrays and plain values."""
        setup = self._setup
        return {
            "to_begin": list(self._to_begin),
            "episodes": list(self._episodes),
            "episode_seeds": list(self._episode_seeds),
            "steps": self._steps.tolist(),
            "returns": self._returns.copy(),
            "recurrent": {level: state.copy() for level, state in self._states.items()},
            "noise": setup.noise.state(),
            "chunks": setup.cutter.state(),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Restore the rollout that `state` was taken from, before the first step of this one.

        The policy that decided then must have been adopted, and the environments must have been restored.

        Raises:
            KeyError, TypeError, ValueError: `state` does not fit.
        """
        setup = self._setup
        setup.noise.load_state(state["noise"])
        self._to_begin, self._episodes = list(state["to_begin"]), list(state["episodes"])
        self._episode_seeds = list(state["episode_seeds"])
        self._steps[:], self._returns[:] = state["steps"], state["returns"]
        for level, recurrent in self._states.items():
            recurrent[:] = state["recurrent"][level]
        setup.cutter.load_state(state["chunks"])

    @property
    def open_decisions(self) -> int:
        """Decisions of all environments that are not yet in a chunk that was returned."""
        return 0 if self._prepared is None else self._prepared.cutter.open_decisions

    def flush(self) -> list[Chunk]:
        """Return the open chunks, padded."""
        return [] if self._prepared is None else self._prepared.cutter.flush()

    @property
    def _setup(self) -> _Setup:
        if self._prepared is None:
            raise RuntimeError("there is no policy yet")
        return self._prepared

    def _prepare(self, policy: OnnxPolicy) -> _Setup:
        """Make the environments and the chunk cutter for the policy's description."""
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
        return _Setup(description, batch, noise, cutter)

    def _begin_episode(self, setup: _Setup, env_index: int) -> None:
        seed = self._seeds.episode(env_index, self._episodes[env_index])
        self._episodes[env_index] += 1  # before the reset: a seed that fails is not tried again
        setup.batch.reset(env_index, seed)
        setup.cutter.begin(env_index, seed)
        setup.noise.reset(env_index)
        for state in self._states.values():
            state[env_index] = 0
        self._episode_seeds[env_index] = seed
        self._steps[env_index] = 0
        self._returns[env_index] = 0

    def _decide(self, setup: _Setup, policy: OnnxPolicy, update: PolicyUpdate) -> PolicyStep:
        noise, batch = setup.noise, setup.batch
        explored = noise.uniform() if update.uniform_exploration else noise.draw(update.noise_scale)
        return policy.step(batch.images, batch.motion, self._states, explored.noise, explored.forced)

    def _count(self, outcome: BatchStep) -> None:
        self._returns += outcome.rewards
        self._steps += 1
        self.statistics.decided(outcome.infos["speed"])

    def _cut(self, decided: PolicyStep, ended: Mapping[int, bool], version: int) -> list[Chunk]:
        """Add the decision, with the states before it, to the chunks."""
        return self._setup.cutter.add(
            states=self._states, actions=decided.actions, policy_version=version, ended=ended
        )

    def _moment(self, setup: _Setup, decided: PolicyStep, outcome: BatchStep) -> Moment:
        return Moment(
            environment=setup.batch.environments[0],
            town=setup.batch.towns[0],
            image=setup.batch.images[0],
            policy_version=self.policy_version,
            episode_seed=self._episode_seeds[0],
            step=int(self._steps[0]),
            decision=setup.description.named_values(decided.actions, 0),
            reward=float(outcome.rewards[0]),
            episode_return=float(self._returns[0]),
        )
