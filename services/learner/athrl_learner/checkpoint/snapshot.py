"""The learner's complete state: copied for a checkpoint, restored on resume."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from athrl_planners import Agent
from athrl_protocol import RunFile
from athrl_protocol.delivery.ledger import Ledger
from athrl_spaces.untrusted import parser_errors
from athrl_spaces.wording import system_reason

from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.checkpoint.recovery import LaterExperience, Recovery
from athrl_learner.errors import CannotResume, SettingsDoNotFit
from athrl_learner.intake.store import ExperienceStore


class Intake(Protocol):
    """Takes chunks in and keeps the ledger: `ChunkIntake` over the network, `LocalIntake` without one."""

    def paused(self) -> AbstractContextManager[None]:
        """Within the context no chunk is taken in."""

    def ledger(self) -> dict[str, dict[str, int]]:
        """The ledger as JSON."""

    def totals(self) -> dict[str, int]:
        """The totals that belong to the ledger."""


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

    `actor` is the state of an actor in the same process, if there is one: tensors and plain values that do
    not change later.

    The ledger lists the chunks in the replay. If the two were copied at different moments, a chunk would be
    counted twice or never after a resume. So the intake is paused, for about a millisecond.
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
    agent_state = {"planner": _copied(agent.state_dict()), "priorities": _to_tensors(priorities)}
    return CheckpointContent(state=state, agent=agent_state, log=position, actor=actor)


@dataclass(frozen=True)
class Restored:
    """What a resumed learner needs beside agent and store.

    Attributes:
        ledger: of all chunks that were settled.
        recovered: chunks after the checkpoint that were restored from the log.
        damaged: records of the log that could not be read, in the run so far.
    """

    ledger: Ledger
    recovered: int = 0
    damaged: int = 0


def restore_snapshot(
    content: CheckpointContent | None,
    agent: Agent,
    store: ExperienceStore,
    later_experience: LaterExperience = "restored",
) -> Restored:
    """Restore planner, replay, limiter and counters, then the experience that the log has after `content`.

    Without `content` that is everything in the log. Experience that will be repeated is not restored.

    Raises:
        CannotResume: checkpoint or log do not fit the run's settings, or cannot be read.
    """
    state: dict[str, Any] = content.state if content is not None else {}
    try:
        with parser_errors(_does_not_fit, RuntimeError):
            ledger = Ledger(state.get("ledger"), state.get("totals"))
            if content is not None:
                agent.load_state_dict(content.agent["planner"])
                store.limiter.load_state(state["limiter"])
                store.restore(int(state["environment_steps"]))
            recovery = Recovery(store, ledger, content.log if content is not None else None)
            recovery.run(
                state["replay"] if content is not None else None,
                later_experience,
                _to_arrays(content.agent["priorities"]) if content is not None else None,
            )
            store.limiter.resume()
    except OSError as error:
        raise CannotResume(f"cannot read the log {store.log.folder}: {system_reason(error)}") from None
    if store.limiter.warmed_up and not len(store.replay):
        # The limiter would permit samples from an empty replay.
        raise CannotResume(
            "the checkpoint's limiter has counted experience that is not in its replay: put the segments of "
            f"{store.log.folder} back from a copy of the run's folder, or start a run of another run.name"
        )
    return Restored(ledger, recovery.chunks, int(state.get("damaged", 0)) + recovery.damaged)


def _does_not_fit(reason: str) -> SettingsDoNotFit:
    return SettingsDoNotFit("the checkpoint", f"was one overridden? {reason}")


def _copied(state: Any) -> Any:
    """The same dictionaries and lists with copied tensors; much faster than a deep copy."""
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
