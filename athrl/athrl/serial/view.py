"""The view of a serial run: the display of `athrl train`, and TensorBoard files."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from athrl_evaluator.event_files import EventFiles
from athrl_learner.components import Components
from athrl_learner.reporting.metrics import LearnerMetrics
from athrl_protocol import EvaluationResult, Phase
from athrl_protocol.announcements.recent_rate import RecentRate
from athrl_protocol.run_file import RunFile

from athrl.display import Display
from athrl.run_view import RunSnapshot
from athrl.serial.actor import NAME, SerialActor

POLL_SECONDS = 0.5
LEAST_SECONDS = 2.0
"""Least time over which a rate is measured."""


class SerialView:
    """Shows a run; it has no effect on the run."""

    def __init__(
        self,
        settings: RunFile,
        folder: Path,
        components: Components,
        actor: SerialActor,
        files: EventFiles,
        display: Display | None,
        changes: Sequence[str] = (),
    ) -> None:
        self._settings = settings
        self._components = components
        self._actor = actor
        self._files = files
        self._display = display
        self._changes = tuple(changes)
        self._learner_metrics = LearnerMetrics(components)
        self._metrics: dict[tuple[str, str], dict[str, float]] = {}
        self._evaluations: dict[str, EvaluationResult] = {}
        self._ending: Phase | None = None
        self._rate = RecentRate()
        self._looked_at = -POLL_SECONDS
        self._where_to_look = [f"run folder {folder}, fingerprints in {folder / 'trace.txt'}"]

    def report(self) -> None:
        """Write the metrics since the last call."""
        self._metrics = {
            ("learner", "learner"): self._learner_metrics.metrics(),
            ("actor", NAME): self._actor.metrics(),
        }
        for (role, name), values in self._metrics.items():
            self._files.add(f"{role}/{name}", values, self._components.store.environment_steps, time.time())

    def note_result(self, result: EvaluationResult) -> None:
        """Add the result of a driver."""
        self._evaluations[result.driver] = result
        self._show()

    def refresh(self) -> None:
        """Show the run if it was not shown just before."""
        if time.monotonic() - self._looked_at >= POLL_SECONDS:
            self._show()

    def finished(self) -> None:
        """Note that training is finished and the closing comparison starts."""
        self._ending = Phase.FINISHED
        self._show()

    def _show(self) -> None:
        self._looked_at = time.monotonic()
        if self._display is None:
            return
        self._rate.note(self._components.store.environment_steps)
        snapshot = RunSnapshot(
            settings=self._settings,
            state=self._learner_metrics.state(self._ending),
            metrics=self._metrics,
            evaluations=self._evaluations,
            present=frozenset({("learner", "learner"), ("actor", NAME), ("evaluator", "evaluator")}),
            changes=self._changes,
            steps_per_second=self._rate.per_second(least=LEAST_SECONDS),
        )
        self._display.show(snapshot, self._where_to_look)
