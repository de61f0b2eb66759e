"""The parts of a learner and how they hang together, fresh or from a checkpoint."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass

import zenoh
from athrl_planners import AtHRL, PolicyExporter
from athrl_protocol import (
    ChunkIntake,
    EvaluationResult,
    EvaluationSubscriber,
    MetricsPublisher,
    PolicyPublisher,
    PresenceWatcher,
    RunFile,
    StatePublisher,
)
from athrl_protocol.limits import largest_chunk_of

from athrl_learner import translation
from athrl_learner.arrivals import Arrivals
from athrl_learner.checkpoint import BestCheckpoint, CheckpointContent
from athrl_learner.checkpointing import Checkpointer
from athrl_learner.publication import Publication, recorded_version
from athrl_learner.reporting import Reporter
from athrl_learner.run_folder import RunFolder
from athrl_learner.segments import IntervalSync, SegmentLog
from athrl_learner.snapshot import restore_snapshot, saved_version
from athrl_learner.store import ExperienceStore
from athrl_learner.training import Trainer

log = logging.getLogger(__name__)

#: The learner's role, and its name: there is one in a run.
NAME = "learner"


@dataclass(frozen=True)
class Parts:
    """Everything that a learner works with."""

    agent: AtHRL
    trainer: Trainer
    store: ExperienceStore
    intake: ChunkIntake
    publication: Publication
    checkpointer: Checkpointer
    reporter: Reporter
    presence: PresenceWatcher
    damaged: int  # records of the log that could not be read, in the run so far


def make_experience(
    run_file: RunFile, agent: AtHRL, arrivals: Arrivals, experience: SegmentLog
) -> ExperienceStore:
    """Replay, limiter and the check of chunks; says how much memory the replay will take."""
    replay = translation.make_replay(run_file, agent)
    log.info("the replay of %d transitions takes %.2f GiB", run_file.replay.capacity, replay.bytes / 2**30)
    return ExperienceStore(
        translation.make_reader(run_file, agent),
        replay,
        translation.make_limiter(run_file),
        arrivals,
        run_file.run.environment_steps,
        experience,
    )


def make_log(stack: contextlib.ExitStack, run_file: RunFile, folder: RunFolder) -> SegmentLog:
    """The log of experience, which goes to the disk at an interval where the run file wants that."""
    experience = translation.make_log(run_file, folder.experience)
    stack.callback(experience.close)
    if run_file.durability.fsync == "interval":
        stack.enter_context(IntervalSync(experience, run_file.durability.fsync_seconds))
    return experience


def make_checkpointer(
    stack: contextlib.ExitStack,
    session: zenoh.Session,
    run_file: RunFile,
    folder: RunFolder,
    experience: SegmentLog,
) -> Checkpointer:
    """The checkpointer, which hears the evaluators' scores of the policy."""
    best = BestCheckpoint(folder.checkpoints)

    def heard(result: EvaluationResult) -> None:
        if result.driver == "policy" and "return_mean" in result.scores:
            best.heard(result.policy_version, result.scores["return_mean"])

    stack.enter_context(EvaluationSubscriber(session, run_file.run.name, heard))
    return Checkpointer(
        folder.checkpoints,
        experience,
        best,
        seconds=run_file.learner.checkpoint_seconds,
        kept=run_file.learner.checkpoints_kept,
    )


def make_publication(
    run_file: RunFile, agent: AtHRL, folder: RunFolder, publisher: PolicyPublisher, arrivals: Arrivals
) -> Publication:
    """Publication that goes on from the newest version which anybody can have."""
    return Publication(
        publisher,
        PolicyExporter(agent),
        folder,
        arrivals,
        seconds=run_file.learner.publish_seconds,
        final_noise_scale=run_file.exploration.final_noise_scale,
        environment_steps_target=run_file.run.environment_steps,
    )


def make_parts(
    stack: contextlib.ExitStack,
    session: zenoh.Session,
    run_file: RunFile,
    folder: RunFolder,
    content: CheckpointContent | None,
) -> Parts:
    """Make all parts; those that hold something of the session are closed by `stack`.

    Raises:
        CannotResume: `content` or the log does not fit the run file.
    """
    run, arrivals = run_file.run.name, Arrivals()
    agent = translation.make_agent(run_file)
    experience = make_log(stack, run_file, folder)
    store = make_experience(run_file, agent, arrivals, experience)
    restored = restore_snapshot(content, agent, store)
    publisher = stack.enter_context(PolicyPublisher(session, run))
    publication = make_publication(run_file, agent, folder, publisher, arrivals)
    publication.version = max(
        recorded_version(folder.latest_policy_facts), saved_version(content) if content is not None else -1
    )
    chunks = ChunkIntake(session, run, store, restored.ledger, largest_chunk_of(run_file))
    intake = stack.enter_context(chunks)
    presence = stack.enter_context(PresenceWatcher(session, run))
    checkpointer = make_checkpointer(stack, session, run_file, folder, experience)
    trainer = Trainer(agent)
    reporter = Reporter(
        stack.enter_context(StatePublisher(session, run)),
        stack.enter_context(MetricsPublisher(session, run, NAME, NAME)),
        store=store,
        arrivals=arrivals,
        trainer=trainer,
        publication=publication,
        checkpointer=checkpointer,
        intake=intake,
        presence=presence,
        recovered=restored.recovered,
        damaged=restored.damaged,
    )
    return Parts(
        agent, trainer, store, intake, publication, checkpointer, reporter, presence, restored.damaged
    )
