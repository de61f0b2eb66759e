"""The learner's whole state at one moment: taken for a checkpoint, put back on resume."""

from __future__ import annotations

import textwrap
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from athrl_planners import Agent
from athrl_protocol import RunFile
from athrl_protocol.ledger import Ledger

from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.errors import CannotResume, SettingsDoNotFit
from athrl_learner.recovery import AfterTheCheckpoint, Recovery
from athrl_learner.store import ExperienceStore


class Intake(Protocol):
    """Who takes chunks in and keeps the ledger: `ChunkIntake` off the network, `DirectIntake` without one."""

    def paused(self) -> AbstractContextManager[None]:
        """Nothing is taken in within the context."""

    def ledger(self) -> dict[str, dict[str, int]]:
        """The ledger as JSON."""

    def totals(self) -> dict[str, int]:
        """The totals that go with it."""


def take_snapshot(
    run_file: RunFile,
    agent: Agent,
    store: ExperienceStore,
    intake: Intake,
    policy_version: int,
    damaged: int = 0,
    actor: dict[str, Any] | None = None,
) -> CheckpointContent:
    """Copy everything but the experience, which is in the log; called between two updates.

    `actor` is the state of an actor that lives in the same process, if one does: tensors and plain values
    that nobody changes later.

    The ledger says which chunks the replay has: were the two of different moments, a chunk would be counted
    twice or never after a resume. So the intake stands still, for about a millisecond.
    """
    with intake.paused(), store.held():
        state = {
            "run_file": run_file.model_dump(),
            "environment_steps": store.environment_steps,
            "updates": agent.updates,
            "policy_version": policy_version,
            "limiter": store.limiter.state(),
            "ledger": intake.ledger(),
            "totals": intake.totals(),
            "damaged": damaged,
            "replay": store.replay.state(),
            "policy": agent.description.to_json(),
        }
        priorities = store.replay.priorities()
        position = store.log_position()
    learnt = {"planner": _copied(agent.state_dict()), "priorities": _to_tensors(priorities)}
    return CheckpointContent(state=state, agent=learnt, log=position, actor=actor)


@dataclass(frozen=True)
class Restored:
    """What a learner goes on with beside agent and store.

    Attributes:
        ledger: of all chunks that were settled.
        recovered: chunks that were taken in from the log, beyond the checkpoint.
        damaged: records of the log that could not be read, in the run so far.
    """

    ledger: Ledger
    recovered: int = 0
    damaged: int = 0


def restore_snapshot(
    content: CheckpointContent | None,
    agent: Agent,
    store: ExperienceStore,
    after_the_checkpoint: AfterTheCheckpoint = "taken in",
) -> Restored:
    """Put planner, replay, limiter and counters back, and take in what the log has beyond `content`.

    Without `content` that is everything in the log; if it is to be driven again, it is not taken in.

    Raises:
        CannotResume: checkpoint or log do not fit the run's settings, or cannot be read.
    """
    state: dict[str, Any] = content.state if content is not None else {}
    try:
        ledger = Ledger(state.get("ledger"), state.get("totals"))
        if content is not None:
            agent.load_state_dict(content.agent["planner"])
            store.limiter.load_state(state["limiter"])
            store.restore(int(state["environment_steps"]))
        recovery = Recovery(store, ledger, content.log if content is not None else None)
        recovery.run(
            state["replay"] if content is not None else None,
            after_the_checkpoint,
            _to_arrays(content.agent["priorities"]) if content is not None else None,
        )
        store.limiter.go_on()
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = textwrap.shorten(str(error), 200)  # torch names every tensor
        raise SettingsDoNotFit("the checkpoint", f"was one overridden? {reason}") from None
    except OSError as error:
        raise CannotResume(f"cannot read the log {store.log.folder}: {error.strerror}") from None
    if store.limiter.warmed_up and not len(store.replay):
        # The limiter would permit samples of nothing, for ever.
        raise CannotResume("the checkpoint's limiter has counted experience that its replay does not hold")
    return Restored(ledger, recovery.chunks, int(state.get("damaged", 0)) + recovery.damaged)


def _copied(state: Any) -> Any:
    """The same dictionaries and lists with copies of their tensors; many times faster than a deep copy."""
    if isinstance(state, torch.Tensor):
        return state.detach().clone()
    if isinstance(state, dict):
        return {name: _copied(value) for name, value in state.items()}
    if isinstance(state, list | tuple):
        return type(state)(_copied(value) for value in state)
    return state


def _to_tensors(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: torch.from_numpy(value) if isinstance(value, np.ndarray) else value
        for name, value in values.items()
    }


def _to_arrays(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: value.numpy() if isinstance(value, torch.Tensor) else value for name, value in values.items()
    }


def saved_version(content: CheckpointContent | None) -> int:
    """The newest policy version when the checkpoint was taken; -1 without one."""
    return content.policy_version if content is not None else -1
