"""The actor of a serial run: environments, rollout and policy, with a state for checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, replace
from typing import Any

from athrl_actor.rollout import Rollout
from athrl_actor.seeds import ActorSeeds
from athrl_driving.policy import environment_config, spread_towns
from athrl_protocol import Chunk, PolicyUpdate
from athrl_protocol.run_file import RunFile

from athrl.serial.environments import RepeatableBatch
from athrl.serial.tensors import to_arrays, to_tensors

NAME = "serial"
#: A distributed actor's incarnation is a time; a serial run only has one actor and one incarnation.
INCARNATION = 0


class SerialActor:
    """Drives as an actor of a distributed run; its state can be saved in the middle of episodes."""

    def __init__(self, run_file: RunFile, stack: ExitStack) -> None:
        """The environments are made with the first policy; `stack` closes them."""
        self._run_file, self._stack = run_file, stack
        self._batch: RepeatableBatch | None = None
        self._rollout = Rollout(
            self._make_batch,
            run_file.actor.environments,
            ActorSeeds(run_file.run.seed, NAME, INCARNATION),
            actor=NAME,
            incarnation=INCARNATION,
            sequence_length=run_file.replay.sequence_length,
        )
        self._policy: PolicyUpdate | None = None

    @property
    def policy(self) -> PolicyUpdate:
        """The current policy."""
        if self._policy is None:
            raise RuntimeError("no policy has been published yet")
        return self._policy

    def set_policy(self, policy: PolicyUpdate) -> None:
        """Use another policy from now on."""
        self._rollout.adopt(policy)
        # The time of publication is not used here, and it would differ between two runs.
        self._policy = replace(policy, published_at=0.0)

    def decide(self) -> list[Chunk]:
        """Make one decision in every environment; return the completed chunks."""
        return self._rollout.step()

    def metrics(self) -> dict[str, float]:
        """Driving metrics since the last call."""
        return self._rollout.statistics.report()

    def state(self) -> dict[str, Any]:
        """The state for `resume`, as tensors and plain values that do not change later."""
        policy = asdict(self.policy)
        assert self._batch is not None  # made with the policy
        state: dict[str, Any] = to_tensors(
            {"policy": policy, "rollout": self._rollout.state(), "environments": self._batch.state()}
        )
        return state

    def resume(self, state: Mapping[str, Any]) -> None:
        """Restore the state of an earlier actor.

        Raises:
            CannotResume: an environment does not return to its earlier state.
            KeyError, TypeError, ValueError: the state does not fit the run's settings.
        """
        arrays = to_arrays(dict(state))
        policy = arrays["policy"]
        self._policy = PolicyUpdate(**{**policy, "artefact": policy["artefact"].tobytes()})
        if len(arrays["environments"]["seeds"]) != len(self._rollout):
            raise ValueError(f"it has {len(arrays['environments']['seeds'])} environments")
        self._rollout.adopt(self._policy)
        assert self._batch is not None  # made with the policy
        self._batch.replay_decisions(arrays["environments"])
        self._rollout.load_state(arrays["rollout"])

    def _make_batch(self, kind: str) -> RepeatableBatch:
        settings = self._run_file.environment.model_dump()
        towns = spread_towns(settings.pop("towns"), self._run_file.actor.environments)
        recorded = self._run_file.replay.sequence_length
        self._batch = RepeatableBatch(towns, environment_config(**settings), kind, recorded)
        self._stack.callback(self._batch.close)
        return self._batch
