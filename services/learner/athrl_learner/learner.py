"""The learner's main loop: train until all experience is trained on, or until it is stopped."""

from __future__ import annotations

import logging
import threading
import time

from athrl_planners import TrainingDiverged
from athrl_protocol import Phase, RunFile
from athrl_protocol.announcements.comparison import compared_decisions

from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.checkpoint.snapshot import take_snapshot
from athrl_learner.components import Components
from athrl_learner.connections import Connections
from athrl_learner.errors import Deadlock, Diverged
from athrl_learner.training.divergence import diverged

log = logging.getLogger(__name__)

#: Seconds that training waits for experience before it checks publication, reports and the stop.
_POLL_SECONDS = 0.1
#: Least seconds that a finished learner stays, so that all services learn of it, and most for its actors.
_LEAST_SECONDS_AT_END = 2.0
_MOST_SECONDS_FOR_ACTORS = 10.0
#: Most seconds that a finished learner stays for an evaluator that is still working.
_MOST_SECONDS_FOR_EVALUATOR = 300.0
#: Seconds that a learner without training left waits for an evaluator that is still being loaded.
_SECONDS_FOR_EVALUATOR_TO_COME = 30.0
#: Seconds without actors and evaluators after which a learner ends whose run was finished and compared
#: before, and the most that it stays for them.
_ALONE_SECONDS = 30.0
_MOST_SECONDS_WHEN_FINISHED = 60.0


class Learner:
    """Runs the components that `run_learner` has put together, in the thread that calls it."""

    def __init__(self, run_file: RunFile, components: Components, connections: Connections) -> None:
        self._run_file = run_file
        self._components = components
        self._connections = connections

    def run(self, stop: threading.Event) -> bool:
        """Publish, train, end; return whether the run is finished (rather than stopped).

        Raises:
            CheckpointFailed: the last checkpoint could not be written.
            Deadlock: actors and learner wait for each other; a checkpoint has been written.
            Diverged: a loss is not finite; the newest checkpoint was written before that.
            LogFailed: the log of experience cannot be written.
        """
        was_over = self._components.store.exhausted
        if was_over and self._is_compared():
            self._say_finished(stop)
            return True
        self._publish()
        self._connections.reporter.report()
        try:
            self._train(stop)
        except TrainingDiverged as error:
            raise self._give_up(str(error)) from None
        except Deadlock:
            self._drain()
            raise
        if self._components.store.exhausted:
            self._finish()
            self._wait_for_services(stop, _SECONDS_FOR_EVALUATOR_TO_COME if was_over else 0.0)
            self._connections.progress.tell_closing()
            return True
        self._drain()
        return False

    def _is_compared(self) -> bool:
        """Whether the closing comparison of a finished run is in its folder."""
        store, folder = self._components.store, self._components.folder
        return compared_decisions(folder.path) == store.environment_steps

    def _say_finished(self, stop: threading.Event) -> None:
        """Nothing is left to do: say so here and to all services that were started too, which then end."""
        steps = self._components.store.environment_steps
        log.info(
            "the run is finished and compared, after %d environment steps; to make it longer set "
            "run.environment_steps above that",
            steps,
        )
        self._connections.intake.stop_accepting(finished=True)
        self._connections.reporter.announce_end(Phase.FINISHED)
        began = alone_since = time.monotonic()
        while not stop.wait(_POLL_SECONDS):
            now = time.monotonic()
            # Not routers, which stay until the learner has left.
            if any(role in ("actor", "evaluator") for role, _ in self._connections.presence.present()):
                alone_since = now
            if now - alone_since > _ALONE_SECONDS or now - began > _MOST_SECONDS_WHEN_FINISHED:
                return
            self._connections.reporter.report_if_due()

    def _train(self, stop: threading.Event) -> None:
        components = self._components
        while not stop.is_set() and not components.store.exhausted:
            if self._connections.intake.failure is not None:
                raise self._connections.intake.failure
            batch = components.store.sample(timeout=_POLL_SECONDS)
            if batch is not None:
                components.trainer.update(batch, components.store.progress)
            if components.publication.due(components.trainer.updates):
                components.trainer.require_finite()
                self._publish()
            if components.checkpointer.due:
                components.trainer.require_finite()
                components.checkpointer.write_in_background(self._snapshot())
            components.store.require_progress(self._run_file.learner.deadlock_seconds)
            self._connections.reporter.report_if_due()
        components.trainer.require_finite()  # the last policy and the last checkpoint follow

    def _give_up(self, what: str) -> Diverged:
        """Training has diverged: keep what was acknowledged and the checkpoints, and return the error."""
        components = self._components
        self._connections.intake.stop_accepting(finished=False)
        self._connections.reporter.announce_end(Phase.DRAINING)
        components.checkpointer.wait()  # a checkpoint that is being written is from before
        return diverged(components.folder, what, components.trainer.updates, components.trainer.batch)

    def _finish(self) -> None:
        """All experience is trained on: publish the last policy, announce the end, write a checkpoint."""
        components = self._components
        self._connections.intake.stop_accepting(finished=True)
        self._publish()
        self._connections.progress.begin_closing()
        self._connections.reporter.announce_end(Phase.FINISHED)
        log.info(
            "finished after %d environment steps and %d updates; policy version %d",
            components.store.environment_steps,
            components.trainer.updates,
            components.publication.version,
        )
        components.checkpointer.write_now(self._snapshot())

    def _drain(self) -> None:
        """Stopped before the end: accept no more chunks, then save everything that was acknowledged."""
        components = self._components
        self._connections.intake.stop_accepting(finished=False)
        self._connections.reporter.announce_end(Phase.DRAINING)
        log.info(
            "stopped after %d environment steps; writing a checkpoint", components.store.environment_steps
        )
        components.checkpointer.write_now(self._snapshot())

    def _wait_for_services(self, stop: threading.Event, comes_within: float) -> None:
        """Stay while services need the learner: actors for a moment, an evaluator until it is done.

        `comes_within` are the seconds to wait for an evaluator to start.
        """
        began, evaluator_came = time.monotonic(), False
        while not stop.is_set():
            waited = time.monotonic() - began
            roles = {role for role, _ in self._connections.presence.present()}
            actors_stay = "actor" in roles and waited < _MOST_SECONDS_FOR_ACTORS
            evaluator_stays = "evaluator" in roles and waited < _MOST_SECONDS_FOR_EVALUATOR
            evaluator_came = evaluator_came or "evaluator" in roles
            evaluator_comes = not evaluator_came and waited < comes_within
            if waited >= _LEAST_SECONDS_AT_END and not (actors_stay or evaluator_stays or evaluator_comes):
                return
            self._connections.reporter.report_if_due()
            stop.wait(_POLL_SECONDS)

    def _publish(self) -> None:
        self._components.publication.publish(
            updates=self._components.trainer.updates,
            environment_steps=self._components.store.environment_steps,
            uniform_exploration=not self._components.store.limiter.warmed_up,
        )

    def _snapshot(self) -> CheckpointContent:
        components = self._components
        return take_snapshot(
            self._run_file,
            components.agent,
            components.store,
            self._connections.intake,
            components.publication.version,
            components.damaged,
        )
