"""Receives experience, trains, publishes policies and writes checkpoints.

Importing the package imports no torch, which takes seconds: what needs it is imported when its name is first
used. `log` and `files` need none.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

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

_MODULE_OF_NAME = {
    "SamplesPerInsert": "intake.limiter",
    "Summary": "run",
    "check_run": "run",
    "run_learner": "run",
}


def __getattr__(name: str) -> Any:
    """Import the module of a public name when the name is first used."""
    if name not in _MODULE_OF_NAME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF_NAME[name]}"), name)
