"""Training that has diverged: its batch is saved, and no checkpoint is written."""

from __future__ import annotations

import dataclasses
import io
import logging
from typing import Any

import numpy as np
from athrl_planners import Batch
from athrl_spaces.wording import system_reason

from athrl_learner.checkpoint.content import numbered_checkpoints
from athrl_learner.errors import Diverged
from athrl_learner.files import Files, write_whole
from athrl_learner.run_folder import RunFolder

log = logging.getLogger(__name__)


def diverged(folder: RunFolder, what: str, updates: int, batch: Batch | None) -> Diverged:
    """Write the batch into the run's folder, as arrays by name, and return the error."""
    checkpoints = numbered_checkpoints(folder.checkpoints)
    kept = "there is no checkpoint"
    if checkpoints:
        kept = f"the newest checkpoint, {checkpoints[-1][1].name}, was written before"
    path = folder.path / "diverged" / f"update-{updates + 1}.npz"
    written = "its batch could not be written"
    if batch is not None:
        content = io.BytesIO()
        arrays: dict[str, Any] = _arrays(dataclasses.asdict(batch))
        np.savez_compressed(content, **arrays)
        try:
            path.parent.mkdir(exist_ok=True)
            write_whole(Files(), path, content.getvalue())
            written = f"its batch is in {path}"
        except OSError as error:
            log.warning("cannot write %s: %s", path, system_reason(error))
    return Diverged(
        f"training has diverged: {what}; {kept}, {written}. Resume with a smaller planner.learning_rate"
    )


def _arrays(values: dict[str, Any]) -> dict[str, np.ndarray]:
    """The arrays of a batch by name, those of levels by `name/level`."""
    arrays: dict[str, np.ndarray] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            arrays.update({f"{name}/{level}": array for level, array in value.items()})
        else:
            arrays[name] = value
    return arrays
