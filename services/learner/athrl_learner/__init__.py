"""Receives experience, trains, publishes policies and writes checkpoints."""

from athrl_learner.errors import (
    CannotResume,
    CheckpointFailed,
    DamagedCheckpoint,
    LearnerError,
    RunFolderInUse,
    RunFolderTaken,
)
from athrl_learner.intake.limiter import SamplesPerInsert
from athrl_learner.run import Summary, check_run, run_learner

__all__ = [
    "CannotResume",
    "CheckpointFailed",
    "DamagedCheckpoint",
    "LearnerError",
    "RunFolderInUse",
    "RunFolderTaken",
    "SamplesPerInsert",
    "Summary",
    "check_run",
    "run_learner",
]
