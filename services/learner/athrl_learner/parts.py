"""The parts of a learner and how they hang together, fresh or from a checkpoint."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass

import zenoh
from athrl_planners import AtHRL, PolicyExporter
from athrl_protocol import (
    ChunkIntake,
    MetricsPublisher,
    PolicyPublisher,
    PresenceWatcher,
    RunFile,
    StatePublisher,
)
from athrl_protocol.limits import largest_chunk_of

from athrl_learner import translation
from athrl_learner.arrivals import Arrivals
from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.checkpointing import Checkpointer
from athrl_learner.publication import Publication, recorded_version
from athrl_learner.reporting import Reporter
from athrl_learner.run_folder import RunFolder
from athrl_learner.snapshot import restore_snapshot, saved_ledger, saved_version
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


def make_experience(run_file: RunFile, agent: AtHRL, arrivals: Arrivals) -> ExperienceStore:
    """Replay, limiter and the check of chunks; says how much memory the replay will take."""
    replay = translation.make_replay(run_file, agent)
    log.info("the replay of %d transitions takes %.2f GiB", run_file.replay.capacity, replay.bytes / 2**30)
    return ExperienceStore(
        translation.make_reader(run_file, agent),
        replay,
        translation.make_limiter(run_file),
        arrivals,
        run_file.run.environment_steps,
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
        CannotResume: `content` does not fit the run file.
    """
    run, arrivals = run_file.run.name, Arrivals()
    agent = translation.make_agent(run_file)
    store = make_experience(run_file, agent, arrivals)
    if content is not None:
        restore_snapshot(content, agent, store)
    publisher = stack.enter_context(PolicyPublisher(session, run))
    publication = make_publication(run_file, agent, folder, publisher, arrivals)
    publication.version = max(
        recorded_version(folder.latest_policy_facts), saved_version(content) if content is not None else -1
    )
    ledger = saved_ledger(content) if content is not None else None
    intake = stack.enter_context(ChunkIntake(session, run, store.accept, ledger, largest_chunk_of(run_file)))
    presence = stack.enter_context(PresenceWatcher(session, run))
    learner = run_file.learner
    checkpointer = Checkpointer(folder.checkpoints, learner.checkpoint_seconds, learner.checkpoints_kept)
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
    )
    return Parts(agent, trainer, store, intake, publication, checkpointer, reporter, presence)
