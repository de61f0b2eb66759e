"""The learner's connections to the other services of its run: everything that needs the network."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import zenoh
from athrl_protocol import (
    ChunkIntake,
    EvaluationResult,
    EvaluationSubscriber,
    MetricsPublisher,
    MetricsSubscriber,
    PolicyPublisher,
    PresenceWatcher,
    RivalWatch,
    RunFile,
    StatePublisher,
)
from athrl_protocol.announcements.answers import FreeNames
from athrl_protocol.security.certificates import find_certificates, read_bound_names
from athrl_protocol.transport.size_filter import largest_chunk_of

from athrl_learner.components import Components
from athrl_learner.log import IntervalSync
from athrl_learner.reporting.exposition import Exposition
from athrl_learner.reporting.metrics import LearnerMetrics
from athrl_learner.reporting.progress import ProgressLog
from athrl_learner.reporting.reporter import Reporter
from athrl_learner.run_settings import NAME


@dataclass(frozen=True)
class Connections:
    """How a learner and the other services communicate."""

    intake: ChunkIntake
    presence: PresenceWatcher
    reporter: Reporter
    progress: ProgressLog


def connect(
    stack: contextlib.ExitStack,
    session: zenoh.Session,
    run_file: RunFile,
    components: Components,
    policies: PolicyPublisher,
    exposition: Exposition,
) -> Connections:
    """Start to receive chunks and scores and to report; all of it ends with `stack`."""
    run = run_file.run.name
    if run_file.durability.fsync == "interval":
        stack.enter_context(IntervalSync(components.store.log, run_file.durability.fsync_seconds))
    chunks = ChunkIntake(session, run, components.store, components.ledger, largest_chunk_of(run_file))
    intake = stack.enter_context(chunks)
    presence = stack.enter_context(PresenceWatcher(session, run))
    shown = find_certificates(run_file.network.certificates, NAME)
    bound = read_bound_names(shown) if shown is not None else ()
    stack.enter_context(FreeNames(session, run, "actor", presence, bound))

    progress = ProgressLog()

    def add_score(result: EvaluationResult) -> None:
        progress.add(result)
        exposition.scores.take(result)
        if result.driver == "policy" and "return_mean" in result.scores:
            components.best.add_score(result.policy_version, result.scores["return_mean"])

    stack.enter_context(EvaluationSubscriber(session, run, add_score))
    states = stack.enter_context(StatePublisher(session, run))
    reporter = Reporter(
        states,
        stack.enter_context(MetricsPublisher(session, run, NAME, NAME)),
        LearnerMetrics(components),
        intake,
        presence,
        stack.enter_context(RivalWatch(session, run, policies, states)),
        progress,
        exposition.learner.show,
    )
    if run_file.metrics.listen:  # a thousand actors report a thousand times a second
        stack.enter_context(MetricsSubscriber(session, run, exposition.actors.take, role="actor"))
    return Connections(intake, presence, reporter, progress)
