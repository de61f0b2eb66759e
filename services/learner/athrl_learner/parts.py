"""The parts of a learner that need no network, and how they hang together, fresh or from a checkpoint."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass

from athrl_planners import Agent, PolicyExporter
from athrl_protocol import PolicyUpdate, RunFile
from athrl_protocol.ledger import Ledger

from athrl_learner import translation
from athrl_learner.arrivals import Arrivals
from athrl_learner.checkpoint import BestCheckpoint, CheckpointContent
from athrl_learner.checkpointing import Checkpointer
from athrl_learner.errors import SettingsDoNotFit
from athrl_learner.memory import require_memory
from athrl_learner.publication import Publication
from athrl_learner.recovery import AfterTheCheckpoint
from athrl_learner.run_folder import RunFolder
from athrl_learner.same_policy import changed_settings, require_same_policy
from athrl_learner.segments import SegmentLog
from athrl_learner.snapshot import restore_snapshot
from athrl_learner.store import ExperienceStore
from athrl_learner.training import Trainer

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Parts:
    """Everything that a learner works with, wherever its experience comes from.

    Attributes:
        agent: the planner.
        trainer: updates them.
        arrivals: which actor sent how much.
        store: replay, log and limiter.
        ledger: of the chunks that are settled; the intake continues with it.
        publication: hands the policy out.
        best: hears what evaluators say, and knows the best checkpoint.
        checkpointer: writes checkpoints.
        recovered: chunks that were taken in from the log, beyond the checkpoint.
        damaged: records of the log that could not be read, in the run so far.
        folder: the run's.
    """

    agent: Agent
    trainer: Trainer
    arrivals: Arrivals
    store: ExperienceStore
    ledger: Ledger
    publication: Publication
    best: BestCheckpoint
    checkpointer: Checkpointer
    recovered: int
    damaged: int
    folder: RunFolder


def make_experience(
    run_file: RunFile, agent: Agent, arrivals: Arrivals, experience: SegmentLog
) -> ExperienceStore:
    """Replay, limiter and the check of chunks; says how much memory the replay will take.

    Raises:
        TooLittleMemory: it takes more than this machine gives.
    """
    replay = translation.make_replay(run_file, agent)
    require_memory(replay.bytes, run_file.replay.capacity)
    log.info("the replay of %d transitions takes %.2f GiB", run_file.replay.capacity, replay.bytes / 2**30)
    return ExperienceStore(
        translation.make_reader(run_file, agent),
        replay,
        translation.make_limiter(run_file, agent),
        arrivals,
        run_file.run.environment_steps,
        experience,
        translation.largest_sample(run_file, agent),
    )


def make_parts(
    stack: contextlib.ExitStack,
    run_file: RunFile,
    folder: RunFolder,
    content: CheckpointContent | None,
    hand_out: Callable[[PolicyUpdate], object],
    after_the_checkpoint: AfterTheCheckpoint = "taken in",
) -> Parts:
    """Make all parts; the log is closed by `stack`.

    Args:
        stack: closes what has to be closed.
        run_file: the settings.
        folder: the run's, locked.
        content: the checkpoint to go on from, if any.
        hand_out: brings a published policy to those who drive with it.
        after_the_checkpoint: what becomes of the experience that the log has beyond `content`.

    Raises:
        CannotResume: `content` or the log does not fit the run file.
        TooLittleMemory: the replay takes more than this machine gives.
    """
    arrivals = Arrivals()
    agent = translation.make_agent(run_file)
    require_same_policy(folder, content, agent.description, run_file)
    experience = translation.make_log(run_file, folder.experience)
    stack.callback(experience.close)
    store = make_experience(run_file, agent, arrivals, experience)
    try:
        restored = restore_snapshot(content, agent, store, after_the_checkpoint)
    except SettingsDoNotFit as error:
        changed = changed_settings(folder, content, run_file)
        if changed:
            raise SettingsDoNotFit(error.what, changed) from None
        raise
    publication = Publication(
        hand_out,
        PolicyExporter(agent),
        folder,
        arrivals,
        seconds=run_file.learner.publish_seconds,
        final_noise_scale=run_file.exploration.final_noise_scale,
        environment_steps_target=run_file.run.environment_steps,
    )
    best = BestCheckpoint(folder.checkpoints)
    checkpointer = Checkpointer(
        folder.checkpoints,
        experience,
        best,
        seconds=run_file.learner.checkpoint_seconds,
        kept=run_file.learner.checkpoints_kept,
    )
    return Parts(
        agent,
        Trainer(agent, store.replay),
        arrivals,
        store,
        restored.ledger,
        publication,
        best,
        checkpointer,
        restored.recovered,
        restored.damaged,
        folder,
    )
