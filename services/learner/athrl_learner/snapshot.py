"""The learner's whole state at one moment: taken for a checkpoint, put back on resume."""

from __future__ import annotations

import copy
import textwrap
from typing import Any

import numpy as np
from athrl_planners import AtHRL
from athrl_protocol import ChunkIntake, RunFile

from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.errors import CannotResume
from athrl_learner.store import ExperienceStore


def take_snapshot(
    run_file: RunFile, agent: AtHRL, store: ExperienceStore, intake: ChunkIntake, policy_version: int
) -> CheckpointContent:
    """Copy everything; called between two updates. The intake stands still while the replay is copied.

    The ledger says which chunks the replay has: were the two of different moments, a chunk would be counted
    twice or never after a resume.
    """
    with intake.paused(), store.held():
        ledger = intake.ledger()
        replay = store.replay.state()
        limiter = store.limiter.state()
        environment_steps = store.environment_steps
    arrays = {name: value for name, value in replay.items() if isinstance(value, np.ndarray)}
    return CheckpointContent(
        state={
            "run_file": run_file.model_dump(),
            "environment_steps": environment_steps,
            "updates": agent.updates,
            "policy_version": policy_version,
            "limiter": limiter,
            "ledger": ledger,
            "replay": {name: value for name, value in replay.items() if name not in arrays},
        },
        agent=copy.deepcopy(agent.state_dict()),
        replay=arrays,
    )


def restore_snapshot(content: CheckpointContent, agent: AtHRL, store: ExperienceStore) -> None:
    """Put planner, replay, limiter and step counter back; `saved_ledger` and `saved_version` are the rest.

    Raises:
        CannotResume: the checkpoint does not fit the run's settings.
    """
    state: dict[str, Any] = content.state
    try:
        agent.load_state_dict(content.agent)
        store.replay.load_state({**state["replay"], **content.replay})
        store.limiter.load_state(state["limiter"])
        store.restore(int(state["environment_steps"]))
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = textwrap.shorten(str(error), 200)  # torch names every tensor
        raise CannotResume(
            f"the checkpoint does not fit the run's settings; was one overridden? {reason}"
        ) from None
    if store.limiter.warmed_up and not len(store.replay):
        # The limiter would permit samples of nothing, for ever.
        raise CannotResume("the checkpoint's limiter has counted experience that its replay does not hold")


def saved_ledger(content: CheckpointContent) -> dict[str, Any]:
    """Which chunks were taken in, for the intake."""
    return dict(content.state["ledger"])


def saved_version(content: CheckpointContent) -> int:
    """The newest policy version when the checkpoint was taken."""
    return int(content.state["policy_version"])
