"""The planners: policies, their training, the replay, and the exported artefact.

`planner` and `settings` define a planner, `registry` lists them; these need no torch. `networks`, `updates`
and `replay` are parts that `training.agent` puts together; `export` makes the artefact. Each planner is a
folder: `athrl`, `hddpg`, `ddpg`, `hdqn`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from athrl_spaces.first_use import on_first_use

from athrl_planners.planner import LevelPlan, Planner
from athrl_planners.registry import UnknownPlanner, planner, planners, settings_tables

if TYPE_CHECKING:
    from athrl_planners.errors import TrainingDiverged
    from athrl_planners.export import PolicyExporter
    from athrl_planners.factories import make_agent
    from athrl_planners.replay import Batch, Sequence, SequenceBatch, SequenceReplay, TransitionBatch
    from athrl_planners.training.agent import Agent
    from athrl_planners.training.policy import PolicyOutput

# Most of them need torch, which takes seconds.
__getattr__ = on_first_use(
    __name__,
    {
        "Agent": "training.agent",
        "Batch": "replay",
        "PolicyExporter": "export",
        "PolicyOutput": "training.policy",
        "Sequence": "replay",
        "SequenceBatch": "replay",
        "SequenceReplay": "replay",
        "TrainingDiverged": "errors",
        "TransitionBatch": "replay",
        "make_agent": "factories",
    },
)

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
