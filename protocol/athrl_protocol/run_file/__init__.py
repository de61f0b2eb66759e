"""The run file: all settings of a run, with every default in one place."""

from athrl_protocol.run_file.documentation import (
    Setting,
    default_toml,
    planner_settings,
    saved_toml,
    settings,
    to_toml,
)
from athrl_protocol.run_file.maps import are_other_towns, require_same_maps, with_whole_maps
from athrl_protocol.run_file.planner_tables import PlannerSection, declare_planners, declared_planners
from athrl_protocol.run_file.reading import OverrideFrom, read_run_file
from athrl_protocol.run_file.reference import reference_page
from athrl_protocol.run_file.root import RunFile
from athrl_protocol.run_file.sections import (
    ActorSection,
    EnvironmentSection,
    EvaluatorSection,
    ExplorationSection,
    LearnerSection,
    MetricsSection,
    NetworkSection,
    ReplaySection,
    RunSection,
    SerialSection,
)

__all__ = [
    "ActorSection",
    "EnvironmentSection",
    "EvaluatorSection",
    "ExplorationSection",
    "LearnerSection",
    "MetricsSection",
    "NetworkSection",
    "OverrideFrom",
    "PlannerSection",
    "ReplaySection",
    "RunFile",
    "RunSection",
    "SerialSection",
    "Setting",
    "are_other_towns",
    "declare_planners",
    "declared_planners",
    "default_toml",
    "planner_settings",
    "read_run_file",
    "reference_page",
    "require_same_maps",
    "saved_toml",
    "settings",
    "to_toml",
    "with_whole_maps",
]
