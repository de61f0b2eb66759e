"""What ties a learner to the others of its run: everything that needs the network."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import zenoh
from athrl_protocol import (
    ChunkIntake,
    EvaluationResult,
    EvaluationSubscriber,
    MetricsPublisher,
    PresenceWatcher,
    RunFile,
    StatePublisher,
)
from athrl_protocol.limits import largest_chunk_of

from athrl_learner.figures import Figures
from athrl_learner.parts import Parts
from athrl_learner.reporting import Reporter
from athrl_learner.segments import IntervalSync

#: The learner's role, and its name: there is one in a run.
NAME = "learner"


@dataclass(frozen=True)
class Connections:
    """By what a learner hears the others, and they it."""

    intake: ChunkIntake
    presence: PresenceWatcher
    reporter: Reporter


def connect(
    stack: contextlib.ExitStack, session: zenoh.Session, run_file: RunFile, parts: Parts
) -> Connections:
    """Take chunks in from now on, hear the evaluators and report; all of it ends with `stack`."""
    run = run_file.run.name
    if run_file.durability.fsync == "interval":
        stack.enter_context(IntervalSync(parts.store.log, run_file.durability.fsync_seconds))
    chunks = ChunkIntake(session, run, parts.store, parts.ledger, largest_chunk_of(run_file))
    intake = stack.enter_context(chunks)
    presence = stack.enter_context(PresenceWatcher(session, run))

    def heard(result: EvaluationResult) -> None:
        if result.driver == "policy" and "return_mean" in result.scores:
            parts.best.heard(result.policy_version, result.scores["return_mean"])

    stack.enter_context(EvaluationSubscriber(session, run, heard))
    reporter = Reporter(
        stack.enter_context(StatePublisher(session, run)),
        stack.enter_context(MetricsPublisher(session, run, NAME, NAME)),
        Figures(parts),
        intake,
        presence,
    )
    return Connections(intake, presence, reporter)
