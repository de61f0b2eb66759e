"""The learner's life: train until all experience is in and paid for, or until somebody stops it."""

from __future__ import annotations

import logging
import threading
import time

from athrl_planners import TrainingDiverged
from athrl_protocol import Phase, RunFile

from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.connections import Connections
from athrl_learner.divergence import diverged
from athrl_learner.errors import Deadlock, Diverged
from athrl_learner.parts import Parts
from athrl_learner.snapshot import take_snapshot

log = logging.getLogger(__name__)

#: Seconds that training waits for experience before it looks after publication, reports and the stop.
_GLANCE = 0.1
#: Seconds that a finished learner stays at least, so that everybody hears of it, and at most for its actors.
_FAREWELL = 2.0
_ACTORS_LEAVE_WITHIN = 10.0
#: Seconds that one which had nothing left to train waits for an evaluator, which is still being loaded.
_EVALUATOR_COMES_WITHIN = 30.0


class Learner:
    """Runs the parts that `run_learner` has put together, in the thread that calls it."""

    def __init__(self, run_file: RunFile, parts: Parts, connections: Connections) -> None:
        self._run_file = run_file
        self._parts = parts
        self._connections = connections

    def run(self, stop: threading.Event, evaluator_deadline: float) -> bool:
        """Publish, train, end; whether the run is finished (rather than stopped).

        Raises:
            CheckpointFailed: the last checkpoint could not be written.
            Deadlock: actors and learner wait for each other; a checkpoint has been written.
            Diverged: a loss is not finite; the newest checkpoint is from before that.
            LogFailed: the disk does not take what would be acknowledged.
        """
        was_over = self._parts.store.exhausted
        self._publish()
        self._connections.reporter.report()
        try:
            self._train(stop)
        except TrainingDiverged as error:
            raise self._give_up(str(error)) from None
        except Deadlock:
            self._drain()
            raise
        if self._parts.store.exhausted:
            self._finish()
            self._linger(stop, evaluator_deadline, _EVALUATOR_COMES_WITHIN if was_over else 0.0)
            return True
        self._drain()
        return False

    def _train(self, stop: threading.Event) -> None:
        parts = self._parts
        while not stop.is_set() and not parts.store.exhausted:
            if self._connections.intake.failure is not None:
                raise self._connections.intake.failure
            batch = parts.store.sample(timeout=_GLANCE)
            if batch is not None:
                parts.trainer.update(batch, parts.store.progress)
            if parts.publication.due(parts.trainer.updates):
                parts.trainer.require_finite()
                self._publish()
            if parts.checkpointer.due:
                parts.trainer.require_finite()
                parts.checkpointer.write_in_background(self._snapshot())
            parts.store.require_progress(self._run_file.learner.deadlock_seconds)
            self._connections.reporter.report_if_due()
        parts.trainer.require_finite()  # the last policy and the last checkpoint follow

    def _give_up(self, what: str) -> Diverged:
        """Training has diverged: keep what was acknowledged and the checkpoints, and tell of it."""
        parts = self._parts
        self._connections.intake.stop_accepting(finished=False)
        self._connections.reporter.announce_end(Phase.DRAINING)
        parts.checkpointer.wait()  # the one that is being written is from before
        return diverged(parts.folder, what, parts.trainer.updates, parts.trainer.batch)

    def _finish(self) -> None:
        """All experience is in and trained on: the last policy, the news, the last checkpoint."""
        parts = self._parts
        self._connections.intake.stop_accepting(finished=True)
        self._publish()
        self._connections.reporter.announce_end(Phase.FINISHED)
        log.info(
            "finished after %d environment steps and %d updates; policy version %d",
            parts.store.environment_steps,
            parts.trainer.updates,
            parts.publication.version,
        )
        parts.checkpointer.write_now(self._snapshot())

    def _drain(self) -> None:
        """Stopped before the end: take nothing more in, then keep everything that was acknowledged."""
        parts = self._parts
        self._connections.intake.stop_accepting(finished=False)
        self._connections.reporter.announce_end(Phase.DRAINING)
        log.info("stopped after %d environment steps; writing a checkpoint", parts.store.environment_steps)
        parts.checkpointer.write_now(self._snapshot())

    def _linger(self, stop: threading.Event, evaluator_deadline: float, comes_within: float) -> None:
        """Stay for those who still need something: actors for a moment, an evaluator until it is done.

        And for an evaluator to come, so many seconds.
        """
        began, evaluator_came = time.monotonic(), False
        while not stop.is_set():
            waited = time.monotonic() - began
            roles = {role for role, _ in self._connections.presence.present()}
            actors_stay = "actor" in roles and waited < _ACTORS_LEAVE_WITHIN
            evaluator_stays = "evaluator" in roles and waited < evaluator_deadline
            evaluator_came = evaluator_came or "evaluator" in roles
            evaluator_comes = not evaluator_came and waited < comes_within
            if waited >= _FAREWELL and not (actors_stay or evaluator_stays or evaluator_comes):
                return
            self._connections.reporter.report_if_due()
            stop.wait(_GLANCE)

    def _publish(self) -> None:
        self._parts.publication.publish(
            updates=self._parts.trainer.updates,
            environment_steps=self._parts.store.environment_steps,
            uniform_exploration=not self._parts.store.limiter.warmed_up,
        )

    def _snapshot(self) -> CheckpointContent:
        parts = self._parts
        return take_snapshot(
            self._run_file,
            parts.agent,
            parts.store,
            self._connections.intake,
            parts.publication.version,
            parts.damaged,
        )
