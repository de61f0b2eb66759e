"""Observation and action spaces, described once for planners, environments and services.

This package imports no other package of the project and only needs NumPy. `actions` describes a number or a
choice that a planner decides and its exploration, `action_kinds` the actions that an environment takes,
`observation` the observation, `reward_terms` the terms of the reward, `policy` the description of a policy,
`towns` the names of towns. `untrusted` reads files from elsewhere within bounds; every room's parsers use it.
`wording` has words that messages share: why the system refused something, and plurals. `first_use` imports a
package's names when they are used.
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
from athrl_spaces.evaluation import CASE_STUDIES, REFERENCE_DRIVERS
from athrl_spaces.observation import CHANNELS, MOTION, Observation
from athrl_spaces.policy import SCHEMA_VERSION, InvalidDescription, LevelDescription, PolicyDescription
from athrl_spaces.reward_terms import REWARD_TERMS, indices_of_terms, refuse_wrong_terms
from athrl_spaces.towns import RANDOM_TOWNS, TOWNS, is_town, nearest_town, town_seed

__all__ = [
    "ACTION_KINDS",
    "CASE_STUDIES",
    "CHANNELS",
    "DIRECT",
    "MOTION",
    "RANDOM_TOWNS",
    "REFERENCE_DRIVERS",
    "REWARD_TERMS",
    "SCHEMA_VERSION",
    "TOWNS",
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
    "indices_of_terms",
    "is_town",
    "nearest_town",
    "ranks",
    "refuse_wrong_terms",
    "town_seed",
]
