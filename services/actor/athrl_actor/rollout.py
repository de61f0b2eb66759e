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

from athrl_actor.chunks import ChunkCutter
from athrl_actor.seeds import ActorSeeds
from athrl_actor.statistics import DrivingStatistics


@dataclass(frozen=True)
class Moment:
    """What happened in one environment at one decision, for those who look on."""

    environment: TownRow
    image: np.ndarray  # uint8 [H, W, C], after the decision
    policy_version: int
    episode_seed: int
    step: int  # decisions of the episode so far
    intention: float  # NaN: the policy has none
    reward: float
    episode_return: float


class Rollout:
    """The environments of an actor with the recurrent states, the noise and the open chunks of each."""

    def __init__(
        self,
        batch: AnyBatch,
        seeds: ActorSeeds,
        *,
        actor: str,
        incarnation: int,
        sequence_length: int,
        sequences: int = 1,
    ) -> None:
        """Nothing is decided before a policy is adopted.

        `batch` records `sequence_length * sequences` decisions, as many as a chunk has at most.
        """
        self.statistics = DrivingStatistics()
        self._batch = batch
        self._seeds = seeds
        self._actor, self._incarnation = actor, incarnation
        self._sequence_length, self._sequences = sequence_length, sequences
        self._cutter: ChunkCutter | None = None
        self._to_begin = list(range(len(batch)))  # environments whose next episode has not begun
        self._episodes = [0] * len(batch)  # begun so far
        self._episode_seeds = [0] * len(batch)
        self._steps = [0] * len(batch)
        self._returns = np.zeros(len(batch))
        self._update: PolicyUpdate | None = None
        self._policy: OnnxPolicy | None = None
        self._noise: ExplorationNoise | None = None
        self._states: dict[str, np.ndarray] = {}

    @property
    def policy_version(self) -> int:
        """The version that decides; -1 before the first one."""
        return -1 if self._update is None else self._update.version

    def adopt(self, update: PolicyUpdate) -> None:
        """Decide with another policy from now on; episodes and recurrent states go on.

        Raises InvalidPolicy if it cannot be run, or is another kind of policy than the one before.
        """
        policy = OnnxPolicy(update.artefact)
        if self._policy is None:
            self._begin(policy)
        elif policy.metadata != self._policy.metadata:
            raise InvalidPolicy(
                f"policy {update.version} is of another run than the one before: start the actor again"
            )
        self._policy, self._update = policy, update

    def step(self, on_first_row: Callable[[Moment], None] | None = None) -> list[Chunk]:
        """Make one decision in every environment; returns the chunks that it completed.

        `on_first_row` is told what happened in the first environment. Raises EnvironmentFailure, whose rows
        have to be abandoned; what was decided in this call has not happened then.
        """
        policy, update = self._policy, self._update
        if policy is None or update is None:
            raise RuntimeError("there is no policy yet")
        while self._to_begin:
            self._begin_episode(self._to_begin[0])
            del self._to_begin[0]
        decided = self._decide(policy, update, self._batch.images, self._batch.motion)
        last = policy.metadata.acting_level
        outcome = self._batch.step(last.normalised(decided.actions[last.name]))
        self._count(outcome)
        if on_first_row is not None:
            on_first_row(self._moment(decided, outcome))
        ended = np.flatnonzero(outcome.terminated | outcome.truncated).tolist()
        chunks = self._cut(decided, {row: bool(outcome.terminated[row]) for row in ended}, update.version)
        self._states = decided.states
        for row in ended:
            self.statistics.episode_ended(self._returns[row], bool(outcome.infos["collision"][row]))
            self._to_begin.append(row)
        return chunks

    def abandon(self, rows: Iterable[int]) -> int:
        """Give up the episodes of environments that failed; return how many open chunks are lost with them.

        Their next episodes, with other seeds, begin with the next step.
        """
        given_up = list(rows)
        self._to_begin = sorted({*self._to_begin, *given_up})
        return 0 if self._cutter is None else self._cutter.drop(given_up)

    def state(self) -> dict[str, Any]:
        """What `go_on` goes on from, beside the policy and the environments: arrays and plain values."""
        if self._noise is None or self._cutter is None:
            raise RuntimeError("nothing has been driven yet")
        return {
            "to_begin": list(self._to_begin),
            "episodes": list(self._episodes),
            "episode_seeds": list(self._episode_seeds),
            "steps": list(self._steps),
            "returns": self._returns.copy(),
            "recurrent": {level: state.copy() for level, state in self._states.items()},
            "noise": self._noise.state(),
            "chunks": self._cutter.state(),
        }

    def go_on(self, update: PolicyUpdate, state: Mapping[str, Any]) -> None:
        """Be where the rollout was that `state` is of, before the first step of this one.

        `update` is the policy that decided then; the environments have to be where they were.

        Raises:
            InvalidPolicy: the policy cannot be run.
            KeyError, TypeError, ValueError: `state` does not fit.
        """
        self.adopt(update)
        assert self._noise is not None
        assert self._cutter is not None
        self._noise.load_state(state["noise"])
        self._to_begin = list(state["to_begin"])
        self._episodes, self._steps = list(state["episodes"]), list(state["steps"])
        self._episode_seeds = list(state["episode_seeds"])
        self._returns[:] = state["returns"]
        for level, recurrent in self._states.items():
            recurrent[:] = state["recurrent"][level]
        self._cutter.load_state(state["chunks"])

    def flush(self) -> list[Chunk]:
        """Return what is in the open chunks, padded."""
        return [] if self._cutter is None else self._cutter.flush()

    def _begin(self, policy: OnnxPolicy) -> None:
        """Make room for the states of all environments, now that the policy's shape is known."""
        shape = self._batch.images.shape[1:]
        if policy.metadata.image_shape != shape:
            raise InvalidPolicy(
                f"the policy takes images {policy.metadata.image_shape}, the run's are {shape}"
            )
        self._states = policy.initial_states(len(self._batch))
        self._noise = ExplorationNoise(policy.metadata, len(self._batch), self._seeds.exploration())
        self._cutter = ChunkCutter(
            self._actor,
            self._incarnation,
            batch=self._batch,
            environments=len(self._batch),
            sequence_length=self._sequence_length,
            sequences=self._sequences,
            levels={level.name: (level.action_size, level.state_size) for level in policy.metadata.levels},
        )

    def _begin_episode(self, row: int) -> None:
        assert self._noise is not None
        assert self._cutter is not None
        seed = self._seeds.episode(row, self._episodes[row])
        self._episodes[row] += 1  # before the reset: a seed with which it fails is not tried again
        self._batch.reset(row, seed)
        self._cutter.begin(row, seed)
        self._noise.reset(row)
        for state in self._states.values():
            state[row] = 0
        self._episode_seeds[row] = seed
        self._steps[row] = 0
        self._returns[row] = 0

    def _decide(
        self, policy: OnnxPolicy, update: PolicyUpdate, images: np.ndarray, motion: np.ndarray
    ) -> PolicyStep:
        assert self._noise is not None
        if update.uniform_exploration:
            return policy.step(images, motion, self._states, forced=self._noise.uniform())
        return policy.step(images, motion, self._states, noise=self._noise.draw(update.noise_scale))

    def _count(self, outcome: BatchStep) -> None:
        self._returns += outcome.rewards
        for row, speed in enumerate(outcome.infos["speed"].tolist()):
            self._steps[row] += 1
            self.statistics.decided(speed)

    def _cut(self, decided: PolicyStep, ended: Mapping[int, bool], version: int) -> list[Chunk]:
        """Gather the decision, with the states before it."""
        assert self._cutter is not None
        return self._cutter.add(
            states=self._states,
            actions=decided.actions,
            policy_version=version,
            ended=ended,
        )

    def _moment(self, decided: PolicyStep, outcome: BatchStep) -> Moment:
        intention = decided.actions.get("intention")
        return Moment(
            environment=self._batch.environments[0],
            image=self._batch.images[0],
            policy_version=self.policy_version,
            episode_seed=self._episode_seeds[0],
            step=self._steps[0],
            intention=float("nan") if intention is None else float(intention[0, 0]),
            reward=float(outcome.rewards[0]),
            episode_return=float(self._returns[0]),
        )
