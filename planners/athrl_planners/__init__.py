"""The planners: what decides, how it learns, the replay it learns from, and the artefact it becomes.

`planner` and `settings` say what a planner is, `registry` which there are; those need no torch. `networks`,
`updates` and `replay` are parts that `agent` puts together; `export` makes the artefact. Each planner is a
folder: `athrl`, `hddpg`, `ddpg`, `hdqn`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from athrl_planners.planner import LevelPlan, Planner
from athrl_planners.registry import UnknownPlanner, planner, planners, settings_tables

if TYPE_CHECKING:
    from athrl_planners.agent import Agent
    from athrl_planners.diverged import TrainingDiverged
    from athrl_planners.export import PolicyExporter
    from athrl_planners.making import make_agent
    from athrl_planners.policy import PolicyOutput
    from athrl_planners.replay import Batch, Sequence, SequenceBatch, SequenceReplay, TransitionBatch

_WITH_TORCH = {
    "Agent": "agent",
    "Batch": "replay",
    "PolicyExporter": "export",
    "PolicyOutput": "policy",
    "Sequence": "replay",
    "SequenceBatch": "replay",
    "SequenceReplay": "replay",
    "TrainingDiverged": "diverged",
    "TransitionBatch": "replay",
    "make_agent": "making",
}
"""What is loaded when it is asked for."""


def __getattr__(name: str) -> Any:
    if name in _WITH_TORCH:
        return getattr(importlib.import_module(f"athrl_planners.{_WITH_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "Agent",
    "Batch",
    "LevelPlan",
    "Planner",
    "PolicyExporter",
    "PolicyOutput",
    "Sequence",
    "SequenceBatch",
    "SequenceReplay",
    "TrainingDiverged",
    "TransitionBatch",
    "UnknownPlanner",
    "make_agent",
    "planner",
    "planners",
    "settings_tables",
]
