"""The actor of a serial run: environments, rollout and policy, and all of it as a state."""

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
#: A distributed actor's incarnation is of the clock; a serial run has one actor, in one life.
INCARNATION = 0


class SerialActor:
    """Drives as an actor of a distributed run does, and can be written down in the middle of its episodes."""

    def __init__(self, run_file: RunFile, stack: ExitStack) -> None:
        """Environments are made with the first policy; `stack` closes them."""
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
        """What decides."""
        if self._policy is None:
            raise RuntimeError("no policy has been published yet")
        return self._policy

    def adopt(self, policy: PolicyUpdate) -> None:
        """Decide with another policy from now on."""
        self._rollout.adopt(policy)
        # When that was is of no account here, and no two runs would agree on it.
        self._policy = replace(policy, published_at=0.0)

    def decide(self) -> list[Chunk]:
        """Make one decision in every environment; the chunks that this completes."""
        return self._rollout.step()

    def metrics(self) -> dict[str, float]:
        """How the driving goes since the last call."""
        return self._rollout.statistics.report()

    def state(self) -> dict[str, Any]:
        """Everything that `resume` needs, as tensors and plain values that nobody changes later."""
        policy = asdict(self.policy)
        assert self._batch is not None  # since there is a policy
        state: dict[str, Any] = to_tensors(
            {"policy": policy, "rollout": self._rollout.state(), "environments": self._batch.state()}
        )
        return state

    def resume(self, state: Mapping[str, Any]) -> None:
        """Be where the actor was that `state` is of.

        Raises:
            CannotResume: an environment does not come back to where it was.
            KeyError, TypeError, ValueError: the state does not fit the run's settings.
        """
        arrays = to_arrays(dict(state))
        policy = arrays["policy"]
        self._policy = PolicyUpdate(**{**policy, "artefact": policy["artefact"].tobytes()})
        if len(arrays["environments"]["seeds"]) != len(self._rollout):
            raise ValueError(f"it has {len(arrays['environments']['seeds'])} environments")
        self._rollout.adopt(self._policy)
        assert self._batch is not None  # since a policy was adopted
        self._batch.drive_again(arrays["environments"])
        self._rollout.load_state(arrays["rollout"])

    def _make_batch(self, kind: str) -> RepeatableBatch:
        settings = self._run_file.environment.model_dump()
        towns = spread_towns(settings.pop("towns"), self._run_file.actor.environments)
        recorded = self._run_file.replay.sequence_length
        self._batch = RepeatableBatch(towns, environment_config(**settings), kind, recorded)
        self._stack.callback(self._batch.close)
        return self._batch
