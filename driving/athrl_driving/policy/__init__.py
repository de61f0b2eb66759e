"""Drive with a policy artefact: the ONNX runner, exploration noise and a batch of environments.

Needs `onnxruntime` (`pip install athrl-driving[policy]`) and nothing that trains.
"""

from athrl_driving.policy.batch import BatchStep, EnvironmentBatch, environment_config
from athrl_driving.policy.exploration import ExplorationNoise
from athrl_driving.policy.guard import (
    AnyBatch,
    EnvironmentFailure,
    EnvironmentRaised,
    EnvironmentStalled,
    GuardedBatch,
)
from athrl_driving.policy.metadata import (
    ActionMetadata,
    InvalidPolicy,
    LevelMetadata,
    PolicyMetadata,
    parse_metadata,
)
from athrl_driving.policy.recording import Recording
from athrl_driving.policy.runner import OnnxPolicy, PolicyStep

__all__ = [
    "ActionMetadata",
    "AnyBatch",
    "BatchStep",
    "EnvironmentBatch",
    "EnvironmentFailure",
    "EnvironmentRaised",
    "EnvironmentStalled",
    "ExplorationNoise",
    "GuardedBatch",
    "InvalidPolicy",
    "LevelMetadata",
    "OnnxPolicy",
    "PolicyMetadata",
    "PolicyStep",
    "Recording",
    "environment_config",
    "parse_metadata",
]
