"""The run's state and the learner's metrics, those of the network too, once a second."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict

from athrl_protocol import (
    ChunkIntake,
    MetricsPublisher,
    Phase,
    PresenceWatcher,
    RivalWatch,
    StatePublisher,
)

from athrl_learner.reporting.departures import Departures
from athrl_learner.reporting.metrics import LearnerMetrics
from athrl_learner.reporting.progress import ProgressLog, with_silent_actors

#: Seconds between two reports.
INTERVAL = 1.0


class Reporter:
    """Publishes the run's state and the learner's metrics, and logs the progress."""

    def __init__(
        self,
        state_publisher: StatePublisher,
        metrics_publisher: MetricsPublisher,
        metrics: LearnerMetrics,
        intake: ChunkIntake,
        presence: PresenceWatcher,
        rivals: RivalWatch,
        progress: ProgressLog,
        show: Callable[[Mapping[str, float]], object],
    ) -> None:
        """`show` is called with the metrics of each report."""
        self._state_publisher = state_publisher
        self._metrics_publisher = metrics_publisher
        self._metrics = metrics
        self._intake = intake
        self._presence = presence
        self._rivals = rivals
        self._progress = progress
        self._show = show
        self._departures = Departures()
        self._reported_at = time.monotonic()
        self._ending: Phase | None = None

    def announce_end(self, phase: Phase) -> None:
        """Announce DRAINING or FINISHED at once; later reports keep it."""
        self._ending = phase
        self.report()

    def report_if_due(self) -> None:
        """Report if a second has passed since the last report."""
        if time.monotonic() - self._reported_at >= INTERVAL:
            self.report()

    def report(self) -> None:
        """Publish state and metrics now."""
        self._reported_at = time.monotonic()
        state = self._metrics.state(self._ending)
        needs_actors = self._ending is None and state.environment_steps < state.environment_steps_target
        others = self._counts_of_others(needs_actors)
        metrics = {**self._metrics.metrics(), **self._intake_counts(), **others}
        state = with_silent_actors(state, int(metrics["actors"]))
        self._state_publisher.publish(state)
        self._metrics_publisher.publish(metrics)
        self._show(metrics)
        self._progress.report(state, metrics)

    def _counts_of_others(self, needs_actors: bool) -> dict[str, float]:
        actors = frozenset(name for role, name in self._presence.present() if role == "actor")
        self._rivals.check(actors)
        if needs_actors:
            self._departures.update(actors)
        return {
            "actors": float(len(actors)),
            "actors_left": float(self._departures.count),
            "rivals/answerers": float(self._rivals.answerers),
            "rivals/values": float(self._rivals.values),
        }

    def _intake_counts(self) -> dict[str, float]:
        statistics = asdict(self._intake.statistics())
        invalid = statistics.pop("invalid")
        by_sender = statistics.pop("invalid_by_sender")
        counts = {f"intake/{name}": float(value) for name, value in statistics.items()}
        counts["intake/invalid"] = float(sum(invalid.values()))
        counts |= {f"intake/invalid/{reason}": float(count) for reason, count in invalid.items()}
        for sender, reasons in by_sender.items():
            for reason, count in reasons.items():
                counts[f"intake/invalid/{reason}/{sender}"] = float(count)
        return counts
