"""Takes experience in, trains, publishes policies and writes checkpoints."""

from athrl_learner.errors import (
    CannotResume,
    CheckpointFailed,
    DamagedCheckpoint,
    LearnerError,
    RunFolderInUse,
    RunFolderTaken,
)
from athrl_learner.limiter import SamplesPerInsert
from athrl_learner.run import Summary, run_learner

__all__ = [
    "CannotResume",
    "CheckpointFailed",
    "DamagedCheckpoint",
    "LearnerError",
    "RunFolderInUse",
    "RunFolderTaken",
    "SamplesPerInsert",
    "Summary",
    "run_learner",
]
