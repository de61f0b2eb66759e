"""The main loop of a serial run: rounds of one decision in every environment, then updates."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from athrl_learner import CheckpointFailed
from athrl_learner.checkpoint import fingerprint
from athrl_learner.checkpoint.snapshot import take_snapshot
from athrl_learner.components import Components
from athrl_learner.intake.local_intake import LocalIntake
from athrl_learner.training.divergence import diverged
from athrl_planners import TrainingDiverged
from athrl_protocol import Chunk, IntakeBusy
from athrl_protocol.run_file import RunFile

from athrl.serial.actor import SerialActor
from athrl.serial.trace import Trace

log = logging.getLogger(__name__)

_FULL_DISK_SECONDS = 1.0  # between two attempts


@dataclass(frozen=True)
class Intervals:
    """Intervals in updates, where a distributed run uses seconds."""

    publication: int
    checkpoint: int
    score: int
    report: int
    trace: int

    @classmethod
    def of(cls, run_file: RunFile) -> Intervals:
        """The run file's seconds converted to updates, at least one."""

        def updates(seconds: float) -> int:
            return max(1, round(seconds * run_file.serial.updates_per_second))

        return cls(
            publication=updates(run_file.learner.publish_seconds),
            checkpoint=updates(run_file.learner.checkpoint_seconds),
            score=updates(run_file.evaluator.seconds_between),
            report=updates(1.0),
            trace=run_file.serial.trace_updates,
        )


@dataclass(frozen=True)
class Observers:
    """Callbacks of observers, which do not influence the run.

    Attributes:
        score: called when the newest policy should be scored.
        report: called when the metrics since the last call should be written.
        refresh: called after every round.
        files: files that grow during the run, by name; a checkpoint contains their sizes.
    """

    score: Callable[[], object]
    report: Callable[[], object]
    refresh: Callable[[], object]
    files: Callable[[], dict[str, int]]


class SerialRun:
    """Drives and trains alternately, until the run is finished or stopped.

    Nothing depends on the clock. Work that is due after an interval of updates is done at the end of the
    round in which a multiple of the interval was passed, so it does not depend on the time of checkpoints or
    interruptions.
    """

    def __init__(
        self,
        run_file: RunFile,
        components: Components,
        actor: SerialActor,
        trace: Trace,
        observers: Observers,
    ) -> None:
        self._run_file = run_file
        self._components = components
        self._actor = actor
        self._trace = trace
        self._observers = observers
        self._every = Intervals.of(run_file)
        self._intake = LocalIntake(components.store, components.ledger, run_file.network.compression)
        self._saved = False  # whether the newest checkpoint has the current state

    @property
    def finished(self) -> bool:
        """Whether all experience has been trained on."""
        return self._components.store.exhausted

    def begin(self) -> None:
        """Publish the untrained policy, with which a new run starts."""
        self._publish()

    def run(self, stop: threading.Event, stop_at: int | None = None) -> bool:
        """Run until the end, `stop`, or `stop_at` environment steps; return whether the run is finished.

        There is a checkpoint of the last state when this returns.

        Raises:
            CheckpointFailed: it could not be written, or the disk is full and `stop` was set.
            Diverged: a loss is not finite; the newest checkpoint was written before that.
            LogFailed: the log of experience cannot be written.
        """
        try:
            return self._run(stop, stop_at)
        except TrainingDiverged as error:
            trainer = self._components.trainer
            raise diverged(self._components.folder, str(error), trainer.updates, trainer.batch) from None

    def _run(self, stop: threading.Event, stop_at: int | None) -> bool:
        store = self._components.store
        while not self.finished:
            if stop.is_set() or (stop_at is not None and store.environment_steps >= stop_at):
                if not self._saved:
                    log.info("stopped at %s", self._fingerprints())
                    self._save()
                return False
            self._round(stop)
        return True

    def _round(self, stop: threading.Event) -> None:
        """One decision in every environment, the permitted updates, then everything that is due."""
        self._saved = False
        before = self._components.trainer.updates
        for chunk in self._actor.decide():
            if self._components.store.complete:
                break  # the run has all its steps, as a learner would tell an actor
            self._take_in(chunk, stop)
            self._train()
        if self._passed(self._every.publication, before) or self.finished:
            self._publish()
        if self._passed(self._every.score, before):
            self._observers.score()
        if self._passed(self._every.report, before) or self.finished:
            self._observers.report()
        if self._passed(self._every.checkpoint, before):
            self._save_or_warn()
        if self.finished:
            self._finish()
        self._observers.refresh()

    def _passed(self, interval: int, before: int) -> bool:
        """Whether a multiple of `interval` lies between the updates `before` and now."""
        return self._components.trainer.updates // interval > before // interval

    def _take_in(self, chunk: Chunk, stop: threading.Event) -> None:
        while True:
            try:
                self._intake.take_in(chunk)
                return
            except IntakeBusy as busy:
                if self._components.store.disk_space.explain() and not stop.wait(_FULL_DISK_SECONDS):
                    continue
                raise CheckpointFailed(
                    f"stopped in the middle of a round, {busy}; resume the run from its newest checkpoint"
                ) from None

    def _train(self) -> None:
        """Update while samples are owed; the limiter would let training lead, but here it never does."""
        components = self._components
        while components.store.owes_a_batch:
            batch = components.store.sample(timeout=0)
            if batch is None:
                raise RuntimeError("the limiter owes samples and does not permit them")
            components.trainer.update(batch, components.store.progress)
            if components.trainer.updates % self._every.trace == 0:
                self._trace.add(f"{self._where()}: parameters {fingerprint.parameters(components.agent)}")

    def _publish(self) -> None:
        self._components.trainer.require_finite()
        self._components.publication.publish(
            updates=self._components.trainer.updates,
            environment_steps=self._components.store.environment_steps,
            uniform_exploration=not self._components.store.limiter.warmed_up,
        )

    def _finish(self) -> None:
        self._trace.add(f"end, {self._fingerprints()}")
        self._save()

    def _save_or_warn(self) -> None:
        """Write a regular checkpoint; a failure is only logged, as there will be another one."""
        self._trace.add(self._fingerprints())
        try:
            self._save()
        except CheckpointFailed as error:
            self._components.checkpointer.failed += 1
            log.warning("%s; training continues", error)

    def _save(self) -> None:
        components = self._components
        components.trainer.require_finite()
        actor: dict[str, Any] = {**self._actor.state(), "files": self._observers.files()}
        content = take_snapshot(
            self._run_file,
            components.agent,
            components.store,
            self._intake,
            components.publication.version,
            actor=actor,
        )
        components.checkpointer.write_now(content)
        self._saved = True

    def _where(self) -> str:
        return f"update {self._components.trainer.updates}, step {self._components.store.environment_steps}"

    def _fingerprints(self) -> str:
        components = self._components
        return (
            f"{self._where()}: parameters {fingerprint.parameters(components.agent)} "
            f"optimisers {fingerprint.optimisers(components.agent)} "
            f"replay {fingerprint.replay_content(components.store.replay)} "
            f"actor {fingerprint.fingerprint(self._actor.state())}"
        )
