"""What a run begins with: nothing, or a checkpoint of the kind of run that goes on."""

from __future__ import annotations

import logging

from athrl_learner.checkpoint import CheckpointContent, newest_intact_checkpoint, remove_unfinished
from athrl_learner.errors import CannotResume
from athrl_learner.run_folder import RunFolder

log = logging.getLogger(__name__)


def checkpoint_to_go_on_from(
    folder: RunFolder, *, resuming: bool, serial: bool = False
) -> CheckpointContent | None:
    """Look at the locked folder: what to go on from, None for the beginning.

    Args:
        folder: the run's.
        resuming: whether there is a run to go on with; else there must be none.
        serial: which kind of run it is.

    Raises:
        RunFolderTaken: a new run was to be written where one is.
        CannotResume: all checkpoints are damaged, or are of the other kind of run.
    """
    if not resuming:
        folder.require_unused()
        return None
    for path in remove_unfinished(folder.checkpoints):
        log.warning("removed %s, which was never completed", path)
    found = newest_intact_checkpoint(folder.checkpoints)
    if found is None:
        log.warning(
            "%s has no checkpoint yet: training begins anew%s",
            folder.path,
            "" if serial else ", with the experience that is in its log",
        )
        return None
    path, content = found
    if (content.actor is not None) != serial:
        raise CannotResume(_other_kind(serial).format(path))
    log.info("going on from %s, at %d environment steps", path, content.state["environment_steps"])
    return content


def _other_kind(serial: bool) -> str:
    if serial:
        return "{} is of a distributed run, whose environments no checkpoint holds: go on without --serial"
    return "{} is of a serial run, which only goes on as one: athrl train --serial --resume"
