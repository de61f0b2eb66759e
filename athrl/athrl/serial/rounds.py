"""The course of a serial run: rounds of one decision in every environment, and the updates that follow."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from athrl_learner import CheckpointFailed, fingerprint
from athrl_learner.direct import DirectIntake
from athrl_learner.divergence import diverged
from athrl_learner.parts import Parts
from athrl_learner.snapshot import take_snapshot
from athrl_planners import TrainingDiverged
from athrl_protocol import Chunk, IntakeBusy
from athrl_protocol.run_file import RunFile

from athrl.serial.actor import SerialActor
from athrl.serial.trace import Trace

log = logging.getLogger(__name__)

_FULL_DISK_SECONDS = 1.0  # between two tries


@dataclass(frozen=True)
class Intervals:
    """After how many updates something is done; what a distributed run does by the clock."""

    publication: int
    checkpoint: int
    score: int
    report: int
    trace: int

    @classmethod
    def of(cls, run_file: RunFile) -> Intervals:
        """The run file's seconds as updates, at least one."""

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
    """Who looks on. What they do has no influence on the run.

    Attributes:
        score: called when the newest policy is to be scored.
        report: called when the metrics since the last call are to be written down.
        look: called after every round.
        files: those that grow along the run, by name; a checkpoint notes their sizes.
    """

    score: Callable[[], object]
    report: Callable[[], object]
    look: Callable[[], object]
    files: Callable[[], dict[str, int]]


class SerialRun:
    """Drives and trains in turns, until the run is finished or somebody wants it to stop.

    Nothing is decided by the clock. What has to be done every so many updates is done at the end of the round
    in which a multiple of that number was passed, so it does not matter when checkpoints were written or
    where the run was interrupted.
    """

    def __init__(
        self, run_file: RunFile, parts: Parts, actor: SerialActor, trace: Trace, observers: Observers
    ) -> None:
        self._run_file = run_file
        self._parts = parts
        self._actor = actor
        self._trace = trace
        self._observers = observers
        self._every = Intervals.of(run_file)
        self._intake = DirectIntake(parts.store, parts.ledger)
        self._saved = False  # whether the newest checkpoint is of this very moment

    @property
    def finished(self) -> bool:
        """Whether all experience is in and trained on."""
        return self._parts.store.exhausted

    def begin(self) -> None:
        """Publish the policy that is not trained yet, with which a new run begins."""
        self._publish()

    def run(self, stop: threading.Event, stop_at: int | None = None) -> bool:
        """Go on until the end, `stop`, or `stop_at` environment steps; whether the run is finished.

        There is a checkpoint of the last moment when this returns.

        Raises:
            CheckpointFailed: it could not be written, or the disk is full and `stop` was set.
            Diverged: a loss is not finite; the newest checkpoint is from before that.
            LogFailed: the disk does not take experience.
        """
        try:
            return self._run(stop, stop_at)
        except TrainingDiverged as error:
            trainer = self._parts.trainer
            raise diverged(self._parts.folder, str(error), trainer.updates, trainer.batch) from None

    def _run(self, stop: threading.Event, stop_at: int | None) -> bool:
        store = self._parts.store
        while not self.finished:
            if stop.is_set() or (stop_at is not None and store.environment_steps >= stop_at):
                if not self._saved:
                    log.info("stopped at %s", self._fingerprints())
                    self._save()
                return False
            self._round(stop)
        return True

    def _round(self, stop: threading.Event) -> None:
        """One decision in every environment and the updates that it permits, then what is due."""
        self._saved = False
        before = self._parts.trainer.updates
        for chunk in self._actor.decide():
            if self._parts.store.complete:
                break  # the run has all that it wants, as an actor is told by a learner
            self._take_in(chunk, stop)
            self._train()
        if self._passed(self._every.publication, before) or self.finished:
            self._publish()
        if self._passed(self._every.score, before):
            self._observers.score()
        if self._passed(self._every.report, before) or self.finished:
            self._observers.report()
        if self._passed(self._every.checkpoint, before):
            self._save_and_go_on()
        if self.finished:
            self._finish()
        self._observers.look()

    def _passed(self, interval: int, before: int) -> bool:
        """Whether a multiple of `interval` lies between the updates `before` and those of now."""
        return self._parts.trainer.updates // interval > before // interval

    def _take_in(self, chunk: Chunk, stop: threading.Event) -> None:
        while True:
            try:
                self._intake.take_in(chunk)
                return
            except IntakeBusy as busy:
                if self._parts.store.room.explain() and not stop.wait(_FULL_DISK_SECONDS):
                    continue
                raise CheckpointFailed(
                    f"stopped in the middle of a round, {busy}; the run goes on from its newest checkpoint"
                ) from None

    def _train(self) -> None:
        """Update while samples are owed; the limiter would let training run ahead, here it never does."""
        parts = self._parts
        while parts.store.owes_a_batch:
            batch = parts.store.sample(timeout=0)
            if batch is None:
                raise RuntimeError("the limiter owes samples and does not permit them")
            parts.trainer.update(batch, parts.store.progress)
            if parts.trainer.updates % self._every.trace == 0:
                self._trace.add(f"{self._where()}: parameters {fingerprint.parameters(parts.agent)}")

    def _publish(self) -> None:
        self._parts.trainer.require_finite()
        self._parts.publication.publish(
            updates=self._parts.trainer.updates,
            environment_steps=self._parts.store.environment_steps,
            uniform_exploration=not self._parts.store.limiter.warmed_up,
        )

    def _finish(self) -> None:
        self._trace.add(f"end, {self._fingerprints()}")
        self._save()

    def _save_and_go_on(self) -> None:
        """A regular checkpoint; if the disk refuses, there will be another one."""
        self._trace.add(self._fingerprints())
        try:
            self._save()
        except CheckpointFailed as error:
            self._parts.checkpointer.failed += 1
            log.warning("%s; training goes on", error)

    def _save(self) -> None:
        parts = self._parts
        parts.trainer.require_finite()
        actor: dict[str, Any] = {**self._actor.state(), "files": self._observers.files()}
        content = take_snapshot(
            self._run_file, parts.agent, parts.store, self._intake, parts.publication.version, actor=actor
        )
        parts.checkpointer.write_now(content)
        self._saved = True

    def _where(self) -> str:
        return f"update {self._parts.trainer.updates}, step {self._parts.store.environment_steps}"

    def _fingerprints(self) -> str:
        parts = self._parts
        return (
            f"{self._where()}: parameters {fingerprint.parameters(parts.agent)} "
            f"optimisers {fingerprint.optimisers(parts.agent)} "
            f"replay {fingerprint.replay_content(parts.store.replay)} "
            f"actor {fingerprint.fingerprint(self._actor.state())}"
        )
