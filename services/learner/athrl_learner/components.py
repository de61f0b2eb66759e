"""The components of a learner that need no network, made for a new run or from a checkpoint."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass

from athrl_planners import Agent, PolicyExporter, SequenceReplay
from athrl_protocol import PolicyUpdate, RunFile
from athrl_protocol.delivery.ledger import Ledger

from athrl_learner import factories
from athrl_learner.checkpoint import BestCheckpoint, CheckpointContent
from athrl_learner.checkpoint.checkpointer import Checkpointer
from athrl_learner.checkpoint.compatibility import (
    changed_settings,
    require_same_meaning,
    require_same_policy,
)
from athrl_learner.checkpoint.recovery import LaterExperience
from athrl_learner.checkpoint.snapshot import restore_snapshot
from athrl_learner.errors import SettingsDoNotFit
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.store import ExperienceStore
from athrl_learner.log import SegmentLog
from athrl_learner.log.disk_space import DiskSpace, disk_warnings
from athrl_learner.publication import Publication, require_accepted
from athrl_learner.run_folder import RunFolder
from athrl_learner.training.memory import require_memory
from athrl_learner.training.trainer import Trainer

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Components:
    """Everything that a learner consists of, independent of the source of its experience.

    Attributes:
        agent: the planner.
        trainer: updates the planner.
        arrivals: how much each actor sent.
        store: replay, log and limiter.
        ledger: of the chunks that are settled; the intake continues with it.
        publication: publishes the policy.
        best: collects the evaluators' scores and knows the best checkpoint.
        checkpointer: writes checkpoints.
        recovered: chunks after the checkpoint that were restored from the log.
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


def check_new_run(run_file: RunFile) -> None:
    """Check that the replay of a new run fits into this machine, and its policy into actors.

    The replay is not allocated before it is filled.

    Raises:
        TooLittleMemory: it needs more memory than this machine has.
        WrongPlanner: the policy is larger than actors accept.
    """
    agent = factories.make_agent(run_file)
    _affordable_replay(run_file, agent)
    _accepted_exporter(run_file, agent)


def _accepted_exporter(run_file: RunFile, agent: Agent) -> PolicyExporter:
    exporter = PolicyExporter(agent)
    require_accepted(exporter.artefact(), run_file.planner.kind)
    return exporter


def _affordable_replay(run_file: RunFile, agent: Agent) -> SequenceReplay:
    replay = factories.make_replay(run_file, agent)
    require_memory(replay.bytes, run_file.replay.capacity)
    return replay


def make_experience(
    run_file: RunFile,
    agent: Agent,
    arrivals: Arrivals,
    experience: SegmentLog,
    disk_space: DiskSpace | None = None,
) -> ExperienceStore:
    """Replay, limiter and the validation of chunks; logs how much memory the replay will take.

    Raises:
        TooLittleMemory: it needs more memory than this machine has.
    """
    replay = _affordable_replay(run_file, agent)
    log.info("the replay of %d transitions takes %.2f GiB", run_file.replay.capacity, replay.bytes / 2**30)
    return ExperienceStore(
        factories.make_reader(run_file, agent),
        replay,
        factories.make_limiter(run_file, agent),
        arrivals,
        run_file.run.environment_steps,
        experience,
        disk_space,
    )


def make_components(
    stack: contextlib.ExitStack,
    run_file: RunFile,
    folder: RunFolder,
    content: CheckpointContent | None,
    deliver: Callable[[PolicyUpdate], object],
    later_experience: LaterExperience = "restored",
) -> Components:
    """Make all components; the log is closed by `stack`.

    Args:
        stack: closes what has to be closed.
        run_file: the settings.
        folder: the run's, locked.
        content: the checkpoint to resume from, if any.
        deliver: sends a published policy to the actors.
        later_experience: whether experience in the log after `content` is restored or repeated.

    Raises:
        CannotResume: `content` or the log does not fit the run file.
        TooLittleMemory: the replay needs more memory than this machine has.
        WrongPlanner: the policy is larger than actors accept.
    """
    arrivals = Arrivals()
    agent = factories.make_agent(run_file)
    require_same_policy(folder, content, agent.description, run_file)
    require_same_meaning(folder, content, agent.settings.kept_by_a_run, run_file)
    experience = factories.make_log(run_file, folder.experience)
    stack.callback(experience.close)
    warn = disk_warnings()
    store = make_experience(run_file, agent, arrivals, experience, DiskSpace(warn))
    try:
        restored = restore_snapshot(content, agent, store, later_experience)
    except SettingsDoNotFit as error:
        changed = changed_settings(folder, content, run_file)
        if changed:
            raise SettingsDoNotFit(error.what, changed) from None
        raise
    publication = Publication(
        deliver,
        _accepted_exporter(run_file, agent),
        folder,
        arrivals,
        seconds=run_file.learner.publish_seconds,
        final_noise_scale=run_file.exploration.final_noise_scale,
        environment_steps_target=run_file.run.environment_steps,
        warn=warn,
    )
    best = BestCheckpoint(folder.checkpoints)
    checkpointer = Checkpointer(
        folder.checkpoints,
        experience,
        best,
        seconds=run_file.learner.checkpoint_seconds,
        kept=run_file.learner.checkpoints_kept,
        warn=warn,
    )
    return Components(
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
