"""The evaluator: scores new policies on fixed episodes while the run lasts, and compares drivers at its end.

Started with an address and a run's name, it asks the learner for the run file. It listens to the run's
policies, state and metrics, and writes results, recordings and TensorBoard files into the run's folder. It
never holds the run up, so a policy that is replaced before its turn comes is not scored.
"""

from __future__ import annotations

import logging
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import zenoh
from athrl_driving.policy import InvalidPolicy, OnnxPolicy
from athrl_protocol import (
    EvaluationPublisher,
    EvaluationResult,
    FramePublisher,
    MetricsPublisher,
    MetricsReport,
    MetricsSubscriber,
    Phase,
    PolicySubscriber,
    PolicyUpdate,
    RunState,
    StateSubscriber,
    join_run,
)
from athrl_protocol.run_file import RunFile

from athrl_evaluator.broadcast import Broadcast
from athrl_evaluator.drivers import REFERENCE_DRIVERS
from athrl_evaluator.episodes import EpisodeStep, Onlooker, Stopped, drive_episodes
from athrl_evaluator.evaluate import make_batch, make_batch_driver
from athrl_evaluator.event_files import EventFiles
from athrl_evaluator.onlookers import Recorder
from athrl_evaluator.results import ResultsFolder
from athrl_evaluator.scores import Scores, score

ROLE = "evaluator"
ENVIRONMENTS = 8  # stepped together
POLL_SECONDS = 0.2
METRICS_SECONDS = 1.0
LAST_POLICY_SECONDS = 5.0  # how long the last policy may come later than the news that the run is over

log = logging.getLogger(__name__)


def run_evaluator(*, connect: str, run: str, name: str, folder: Path, stop: threading.Event) -> None:
    """Evaluate until the run is finished and compared, or `stop` is set.

    Results are written under `folder/run`. Raises ProtocolError when the learner or the run is not there, or
    another live evaluator has the name.
    """
    with ExitStack() as stack:
        joined = join_run(role=ROLE, connect=connect, run=run, name=name, stop=stop, stack=stack)
        if joined is None:
            return
        session, run_file = joined
        evaluator = Evaluator(session, run_file, name, ResultsFolder(folder, run), stop, stack)
        try:
            evaluator.run()
        except Stopped:
            log.info("stopped in the middle of an evaluation")


class Evaluator(Onlooker):
    """Scores what the run publishes."""

    def __init__(
        self,
        session: zenoh.Session,
        run_file: RunFile,
        name: str,
        folder: ResultsFolder,
        stop: threading.Event,
        stack: ExitStack,
    ) -> None:
        self._run_file = run_file
        self._settings = run_file.evaluator
        self._run = run = run_file.run.name
        self._folder = folder
        self._stop = stop
        self._files = EventFiles(folder.tensorboard)
        stack.callback(self._files.close)
        self._batch = make_batch(run_file.environment, min(ENVIRONMENTS, self._settings.episodes))
        stack.callback(self._batch.close)
        self._policies = stack.enter_context(PolicySubscriber(session, run))
        self._states = stack.enter_context(StateSubscriber(session, run))
        self._results = stack.enter_context(EvaluationPublisher(session, run, name))
        self._metrics = stack.enter_context(MetricsPublisher(session, run, ROLE, name))
        stack.enter_context(MetricsSubscriber(session, run, self._take_metrics))
        frames = stack.enter_context(FramePublisher(session, run, ROLE, name))
        self._broadcast = Broadcast(frames)
        stack.callback(self._broadcast.close)
        self._scored: PolicyUpdate | None = None
        self._scored_at = -float("inf")
        self._episodes_done = 0
        self._last_scores: dict[str, float] = {}
        self._pulse_at = 0.0

    def run(self) -> None:
        """Score new policies until the run is finished, then compare the drivers; raises Stopped."""
        while not self._stop.is_set():
            self._pulse()
            state = self._states.newest()
            if state is not None and state.phase is Phase.FINISHED:
                self._compare(state)
                return
            self._score_newest_if_due()
            self._stop.wait(POLL_SECONDS)

    def on_step(self, step: EpisodeStep) -> None:
        """Go on publishing metrics while episodes are driven."""
        self._pulse()

    def _score_newest_if_due(self) -> None:
        update = self._policies.newest()
        if update is None or update is self._scored:
            return
        if time.monotonic() - self._scored_at < self._settings.seconds_between:
            return
        self._scored_at = time.monotonic()
        self._scored = update
        try:
            policy = OnnxPolicy(update.artefact)
            scores = self._drive(policy, update, self._settings.episodes, self._settings.episodes)
        except InvalidPolicy as error:
            log.warning("policy %d cannot be scored: %s", update.version, error)
            return
        self._take_result("policy", update, scores)

    def _compare(self, state: RunState) -> None:
        """Score the last policy and the reference drivers on the same episodes."""
        update = self._last_policy(state)
        if update is None:
            log.warning("the run is finished, but its policy did not come: no comparison")
            return
        drivers: list[OnnxPolicy | str] = [OnnxPolicy(update.artefact), *REFERENCE_DRIVERS]
        recorded = max(1, self._settings.recordings_kept // len(drivers))
        results = []
        for driver in drivers:
            scores = self._drive(driver, update, self._settings.final_episodes, recorded)
            name = driver if isinstance(driver, str) else "policy"
            results.append(self._take_result(name, update, scores))
        self._folder.write_comparison(self._run, results)

    def _last_policy(self, state: RunState) -> PolicyUpdate | None:
        """The policy that the finished run ended with; it may come a little later than the run's state."""
        deadline = time.monotonic() + LAST_POLICY_SECONDS
        update = self._policies.newest()
        while update is None or update.version < state.policy_version:
            if self._stop.wait(POLL_SECONDS):
                raise Stopped
            if time.monotonic() > deadline:
                break
            update = self._policies.newest()
        return update

    def _drive(self, driver: OnnxPolicy | str, update: PolicyUpdate, episodes: int, recorded: int) -> Scores:
        version = update.version if isinstance(driver, OnnxPolicy) else 0
        drives = make_batch_driver(driver, len(self._batch), version)
        recorder = Recorder(
            drives,
            self._run_file.environment.town,
            self._folder.recordings,
            episodes=recorded,
            kept=self._settings.recordings_kept,
            broadcast=self._broadcast,
        )
        seeds = range(self._settings.seed, self._settings.seed + episodes)
        try:
            results = drive_episodes(drives, self._batch, seeds, [recorder, self], self._stop)
        finally:
            recorder.close()
        self._episodes_done += len(results)
        return score(results)

    def _take_result(self, driver: str, update: PolicyUpdate, scores: Scores) -> EvaluationResult:
        """Write down what a driver scored, then publish it."""
        result = EvaluationResult(
            driver=driver,
            policy_version=update.version if driver == "policy" else 0,
            environment_steps=update.environment_steps,
            town=self._run_file.environment.town,
            seed=self._settings.seed,
            scores=scores.as_dict(),
        )
        self._folder.add(result)
        self._files.add(f"evaluation/{driver}", result.scores, update.environment_steps, time.time())
        self._results.publish(result)
        self._last_scores = result.scores
        log.info("%s, version %d: return %.0f", driver, update.version, scores.return_mean)
        return result

    def _pulse(self) -> None:
        """Publish the evaluator's own metrics about once a second."""
        if time.monotonic() - self._pulse_at < METRICS_SECONDS:
            return
        self._pulse_at = time.monotonic()
        scores = {f"last_{name}": value for name, value in self._last_scores.items()}
        version = 0 if self._scored is None else self._scored.version
        values = {"episodes": self._episodes_done, "policy_version": version, **scores}
        self._metrics.publish(values)

    def _take_metrics(self, report: MetricsReport) -> None:
        """Write down another service's metrics; called from the session's thread."""
        state = self._states.newest()
        steps = state.environment_steps if state is not None else 0
        self._files.add(f"{report.role}/{report.name}", report.values, steps, report.time)
