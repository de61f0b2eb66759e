"""The planners: networks, agents, replay and the policy artefact."""

from athrl_planners.athrl import AtHRL
from athrl_planners.export import PolicyExporter, policy_metadata
from athrl_planners.policy import PolicyOutput
from athrl_planners.replay import SequenceReplay
from athrl_planners.sequence import Sequence, SequenceBatch
from athrl_planners.settings import ActionRange, ObservationSettings, PlannerSettings

__all__ = [
    "ActionRange",
    "AtHRL",
    "ObservationSettings",
    "PlannerSettings",
    "PolicyExporter",
    "PolicyOutput",
    "Sequence",
    "SequenceBatch",
    "SequenceReplay",
    "policy_metadata",
]
