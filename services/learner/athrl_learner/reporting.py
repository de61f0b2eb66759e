"""The run's state and the learner's metrics, once a second.

Beside the figures of the learner itself (`athrl_learner.figures`) these are of the network:

| metric | meaning |
|---|---|
| `actors` | actors that are present |
| `intake/...` | chunks by what became of them, see `IntakeStatistics` |
"""

from __future__ import annotations

import time
from dataclasses import asdict

from athrl_protocol import ChunkIntake, MetricsPublisher, Phase, PresenceWatcher, StatePublisher

from athrl_learner.figures import Figures

#: Seconds between two reports.
INTERVAL = 1.0


class Reporter:
    """Publishes the learner's figures."""

    def __init__(
        self,
        state_publisher: StatePublisher,
        metrics_publisher: MetricsPublisher,
        figures: Figures,
        intake: ChunkIntake,
        presence: PresenceWatcher,
    ) -> None:
        self._state_publisher = state_publisher
        self._metrics_publisher = metrics_publisher
        self._figures = figures
        self._intake = intake
        self._presence = presence
        self._reported_at = time.monotonic()
        self._ending: Phase | None = None

    def announce_end(self, phase: Phase) -> None:
        """Announce DRAINING or FINISHED at once; it stays."""
        self._ending = phase
        self.report()

    def report_if_due(self) -> None:
        """Report if a second has passed since the last report."""
        if time.monotonic() - self._reported_at >= INTERVAL:
            self.report()

    def report(self) -> None:
        """Publish state and metrics now."""
        self._reported_at = time.monotonic()
        self._state_publisher.publish(self._figures.state(self._ending))
        self._metrics_publisher.publish(
            {**self._figures.metrics(), **self._intake_counts(), "actors": self._actors()}
        )

    def _actors(self) -> float:
        return float(sum(role == "actor" for role, _ in self._presence.present()))

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
