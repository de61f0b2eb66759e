"""What a run starts with: nothing, or a checkpoint of the same kind of run."""

from __future__ import annotations

import logging

from athrl_learner.checkpoint import CheckpointContent, newest_intact_checkpoint, remove_unfinished
from athrl_learner.errors import CannotResume
from athrl_learner.run_folder import RunFolder

log = logging.getLogger(__name__)


def checkpoint_to_resume(
    folder: RunFolder, *, resuming: bool, serial: bool = False
) -> CheckpointContent | None:
    """The checkpoint in the locked folder to resume from; None to start from the beginning.

    Args:
        folder: folder of the run.
        resuming: whether the run is resumed; otherwise the folder must not hold one.
        serial: whether it is a serial run.

    Raises:
        RunFolderTaken: a new run was to be written into the folder of another.
        CannotResume: all checkpoints are damaged, or belong to the other kind of run.
    """
    if not resuming:
        folder.require_unused()
        return None
    for path in remove_unfinished(folder.checkpoints):
        log.warning("removed %s, which was never completed", path)
    found = newest_intact_checkpoint(folder.checkpoints, folder.experience)
    if found is None:
        log.warning(
            "%s has no checkpoint yet: training restarts%s",
            folder.path,
            "" if serial else ", with the experience in its log",
        )
        return None
    path, content = found
    if (content.actor is not None) != serial:
        raise CannotResume(_other_kind(serial).format(path))
    log.info("resuming from %s, at %d environment steps", path, content.state["environment_steps"])
    return content


def _other_kind(serial: bool) -> str:
    if serial:
        return "{} is of a distributed run, whose checkpoints hold no environments: resume without --serial"
    return "{} is of a serial run and can only be resumed as one: athrl train --serial --resume"
