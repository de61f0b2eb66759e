"""What a planner sees and decides, described once for planners, environments and services.

The ground floor: it imports no other room, and needs NumPy alone. `actions` has one number or choice that a
planner decides and how it is explored, `action_kinds` what an environment takes, `observation` what is seen,
`reward_terms` what is earned, `policy` what a policy says of itself.
"""

from athrl_spaces.action_kinds import (
    ACTION_KINDS,
    DIRECT,
    WAYPOINT,
    WAYPOINT_SET,
    ActionKind,
    Limits,
    action_kind,
)
from athrl_spaces.actions import Action, Continuous, Discrete, Epsilon, Noise, Sampled, ranks
from athrl_spaces.observation import CHANNELS, MOTION, Observation
from athrl_spaces.policy import SCHEMA_VERSION, InvalidDescription, LevelDescription, PolicyDescription
from athrl_spaces.reward_terms import REWARD_TERMS, places_of_terms, refuse_wrong_terms

__all__ = [
    "ACTION_KINDS",
    "CHANNELS",
    "DIRECT",
    "MOTION",
    "REWARD_TERMS",
    "SCHEMA_VERSION",
    "WAYPOINT",
    "WAYPOINT_SET",
    "Action",
    "ActionKind",
    "Continuous",
    "Discrete",
    "Epsilon",
    "InvalidDescription",
    "LevelDescription",
    "Limits",
    "Noise",
    "Observation",
    "PolicyDescription",
    "Sampled",
    "action_kind",
    "places_of_terms",
    "ranks",
    "refuse_wrong_terms",
]
