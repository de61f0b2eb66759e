"""Receives experience, trains, publishes policies and writes checkpoints.

Importing the package imports no torch, which takes seconds: what needs it is imported when its name is first
used. `log` and `files` need none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from athrl_spaces.first_use import on_first_use

from athrl_learner.errors import (
    CannotResume,
    CheckpointFailed,
    DamagedCheckpoint,
    LearnerError,
    RunFolderInUse,
    RunFolderTaken,
)

if TYPE_CHECKING:
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

__getattr__ = on_first_use(
    __name__,
    {
        "SamplesPerInsert": "intake.limiter",
        "Summary": "run",
        "check_run": "run",
        "run_learner": "run",
    },
)
