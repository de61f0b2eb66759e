"""The run file: what a run is to do, with every default in one place."""

from athrl_protocol.run_file.documentation import Setting, default_toml, settings, to_toml
from athrl_protocol.run_file.reading import read_run_file
from athrl_protocol.run_file.root import RunFile
from athrl_protocol.run_file.sections import (
    ActorSection,
    EnvironmentSection,
    EvaluatorSection,
    ExplorationSection,
    LearnerSection,
    NetworkSection,
    PlannerSection,
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
    "NetworkSection",
    "PlannerSection",
    "ReplaySection",
    "RunFile",
    "RunSection",
    "SerialSection",
    "Setting",
    "default_toml",
    "read_run_file",
    "settings",
    "to_toml",
]
