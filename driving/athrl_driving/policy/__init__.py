"""Drive with a policy artefact: the ONNX runner, exploration noise and a batch of environments.

Needs `onnxruntime` (`pip install athrl-driving[policy]`) and nothing that trains.
"""

from athrl_spaces.policy import LARGEST_ARTEFACT

from athrl_driving.policy.artefact import InvalidPolicy
from athrl_driving.policy.batch import BatchStep, EnvironmentBatch, config_of, environment_config
from athrl_driving.policy.exploration import Exploration, ExplorationNoise
from athrl_driving.policy.guard import (
    AnyBatch,
    EnvironmentFailure,
    EnvironmentRaised,
    EnvironmentStalled,
    GuardedBatch,
)
from athrl_driving.policy.recording import Recording
from athrl_driving.policy.runner import OnnxPolicy, PolicyStep
from athrl_driving.policy.towns import spread_towns

__all__ = [
    "LARGEST_ARTEFACT",
    "AnyBatch",
    "BatchStep",
    "EnvironmentBatch",
    "EnvironmentFailure",
    "EnvironmentRaised",
    "EnvironmentStalled",
    "Exploration",
    "ExplorationNoise",
    "GuardedBatch",
    "InvalidPolicy",
    "OnnxPolicy",
    "PolicyStep",
    "Recording",
    "config_of",
    "environment_config",
    "spread_towns",
]
