"""The evaluator: scores new policies on fixed episodes while the run lasts, and compares drivers at its end.

Started with an address and a run's name, it asks the learner for the run file. It subscribes to the run's
policies, state and metrics, and writes results, recordings and TensorBoard files into the run's folder. It
never delays the run, so a policy that is replaced before its turn is not scored.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from contextlib import ExitStack
from pathlib import Path

import zenoh
from athrl_driving.policy import EnvironmentFailure, InvalidPolicy
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
from athrl_protocol.announcements.comparison import compared_decisions
from athrl_protocol.run_file import RunFile

from athrl_evaluator.broadcast import Broadcast
from athrl_evaluator.exposition import Exposition, open_exposition
from athrl_evaluator.report_limits import ReportLimits
from athrl_evaluator.scorer import Scoring
from athrl_evaluator.scoring.episodes import EpisodeObserver, EpisodeStep, Stopped
from athrl_evaluator.scoring.results import ResultsFolder

ROLE = "evaluator"
POLL_SECONDS = 0.2
METRICS_SECONDS = 1.0
MOST_EARLY_REPORTS = 1000  # that wait for the run's state
LAST_POLICY_SECONDS = 5.0  # how much later than the run's end the last policy may arrive

log = logging.getLogger(__name__)


def run_evaluator(
    *, connect: str, run: str, name: str, folder: Path, stop: threading.Event, metrics_listen: str = ""
) -> None:
    """Evaluate until the run is finished and compared, or `stop` is set.

    Results are written under `folder/run`; metrics are shown at `metrics_listen`, if it is not empty. Raises
    ProtocolError when the learner or the run does not exist, another live evaluator has the name or the
    address is in use, EnvironmentFailure when the closing comparison cannot be driven, and EvaluatorError
    when it cannot be written.
    """
    with ExitStack() as stack:
        exposition = open_exposition(stack, run, metrics_listen)
        joined = join_run(role=ROLE, connect=connect, run=run, name=name, stop=stop, stack=stack)
        if joined is None:
            return
        results = ResultsFolder(folder, run)
        evaluator = Evaluator(joined.session, joined.run_file, name, results, exposition, stop, stack)
        try:
            evaluator.run()
        except Stopped:
            log.info("stopped in the middle of an evaluation")


class Evaluator(EpisodeObserver):
    """Scores the policies that the run publishes."""

    def __init__(
        self,
        session: zenoh.Session,
        run_file: RunFile,
        name: str,
        folder: ResultsFolder,
        exposition: Exposition,
        stop: threading.Event,
        stack: ExitStack,
    ) -> None:
        self._settings = run_file.evaluator
        run = run_file.run.name
        self._stop = stop
        self._folder = folder
        self._exposition = exposition
        frames = stack.enter_context(FramePublisher(session, run, ROLE, name))
        broadcast = Broadcast(frames)
        stack.callback(broadcast.close)
        self._scoring = Scoring(
            run_file, folder, stack, tell=self._take_result, observers=[self], broadcast=broadcast
        )
        self._policies = stack.enter_context(PolicySubscriber(session, run))
        self._states = stack.enter_context(StateSubscriber(session, run))
        self._results = stack.enter_context(EvaluationPublisher(session, run, name))
        self._metrics = stack.enter_context(MetricsPublisher(session, run, ROLE, name))
        self._early: deque[MetricsReport] = deque(maxlen=MOST_EARLY_REPORTS)
        self._limits = ReportLimits()
        stack.enter_context(MetricsSubscriber(session, run, self._take_metrics))
        self._scored: PolicyUpdate | None = None
        self._scored_at = -float("inf")
        self._environments_failed = 0
        self._last_scores: dict[str, float] = {}
        self._metrics_published_at = 0.0

    def run(self) -> None:
        """Score new policies until the run is finished, then compare the drivers; raises Stopped."""
        while not self._stop.is_set():
            self._publish_metrics()
            state = self._states.newest()
            if state is not None and state.phase is Phase.FINISHED:
                self._compare(state)
                return
            self._score_newest_if_due()
            self._stop.wait(POLL_SECONDS)
        log.info("stopped")

    def on_step(self, step: EpisodeStep) -> None:
        """Keep publishing metrics while episodes are driven."""
        self._publish_metrics()

    def _score_newest_if_due(self) -> None:
        update = self._policies.newest()
        if update is None or update is self._scored:
            return
        if time.monotonic() - self._scored_at < self._settings.seconds_between:
            return
        self._scored_at = time.monotonic()
        self._scored = update
        try:
            self._scoring.score_policy(update, stop=self._stop)
        except InvalidPolicy as error:
            log.warning("policy %d cannot be scored: %s", update.version, error)
        except EnvironmentFailure as failure:
            self._environments_failed += 1
            log.warning("policy %d was not scored: %s", update.version, failure)

    def _compare(self, state: RunState) -> None:
        """Score the last policy and the reference drivers on the same episodes, unless that has been done."""
        if compared_decisions(self._folder.path) != state.environment_steps:
            update = self._last_policy(state)
            if update is None:
                log.warning("the run is finished, but its policy did not arrive: no comparison")
                return
            self._scoring.compare(update, self._stop)
        log.info("the run is finished, and its comparison is in %s", self._folder.path)

    def _last_policy(self, state: RunState) -> PolicyUpdate | None:
        """The policy that the finished run ended with; it may arrive a little later than the run's state."""
        deadline = time.monotonic() + LAST_POLICY_SECONDS
        update = self._policies.newest()
        while update is None or update.version < state.policy_version:
            if self._stop.wait(POLL_SECONDS):
                raise Stopped
            if time.monotonic() > deadline:
                break
            update = self._policies.newest()
        return update

    def _take_result(self, result: EvaluationResult) -> None:
        """Publish a driver's scores."""
        self._results.publish(result)
        self._exposition.scores.take(result)
        self._last_scores = result.scores

    def _publish_metrics(self) -> None:
        """Publish the evaluator's own metrics about once a second."""
        if time.monotonic() - self._metrics_published_at < METRICS_SECONDS:
            return
        self._metrics_published_at = time.monotonic()
        scores = {f"last_{name}": value for name, value in self._last_scores.items()}
        version = 0 if self._scored is None else self._scored.version
        values = {
            "episodes": self._scoring.episodes_done,
            "policy_version": version,
            "environments_failed": self._environments_failed,
        }
        self._metrics.publish({**values, **scores})
        self._exposition.evaluator.show(values)

    def _take_metrics(self, report: MetricsReport) -> None:
        """Write another service's metrics to the event files; called from the session's thread.

        They wait until the learner has said how far the run is: a resumed run does not begin at step 0.
        """
        self._early.append(report)
        state = self._states.newest()
        while state is not None and self._early:
            early = self._early.popleft()
            values = self._limits.admitted(early)
            if values:
                name = f"{early.role}/{early.name}"
                self._scoring.files.add(name, values, state.environment_steps, early.time)
