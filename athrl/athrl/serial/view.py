"""What is seen of a serial run: the display of `athrl train`, and the curves in TensorBoard's files."""

from __future__ import annotations

import time
from pathlib import Path

from athrl_evaluator.event_files import EventFiles
from athrl_learner.figures import Figures
from athrl_learner.parts import Parts
from athrl_protocol import EvaluationResult, Phase
from athrl_protocol.run_file import RunFile

from athrl.run_view import RunSnapshot
from athrl.serial.actor import NAME, SerialActor
from athrl.train.display import Display

GLANCE_SECONDS = 0.5
RATE_SECONDS = 30.0
"""Over how long the rate of environment steps is measured."""


class SerialView:
    """Looks at a run; nothing in it changes what the run does."""

    def __init__(
        self,
        settings: RunFile,
        folder: Path,
        parts: Parts,
        actor: SerialActor,
        files: EventFiles,
        display: Display | None,
    ) -> None:
        self._settings = settings
        self._parts = parts
        self._actor = actor
        self._files = files
        self._display = display
        self._figures = Figures(parts)
        self._metrics: dict[tuple[str, str], dict[str, float]] = {}
        self._evaluations: dict[str, EvaluationResult] = {}
        self._ending: Phase | None = None
        self._progress: list[tuple[float, int]] = []
        self._looked_at = -GLANCE_SECONDS
        self._where_to_look = [f"run folder {folder}, fingerprints in {folder / 'trace.txt'}"]

    def report(self) -> None:
        """Write down the metrics since the last call."""
        self._metrics = {
            ("learner", "learner"): self._figures.metrics(),
            ("actor", NAME): self._actor.metrics(),
        }
        for (role, name), values in self._metrics.items():
            self._files.add(f"{role}/{name}", values, self._parts.store.environment_steps, time.time())

    def heard(self, result: EvaluationResult) -> None:
        """A driver was scored."""
        self._evaluations[result.driver] = result
        self._show()

    def look(self) -> None:
        """Show the run if it has not been shown for a moment."""
        if time.monotonic() - self._looked_at >= GLANCE_SECONDS:
            self._show()

    def finished(self) -> None:
        """All experience is in and trained on; the closing comparison begins."""
        self._ending = Phase.FINISHED
        self._show()

    def _show(self) -> None:
        now = self._looked_at = time.monotonic()
        if self._display is None:
            return
        self._progress.append((now, self._parts.store.environment_steps))
        self._progress = [(at, steps) for at, steps in self._progress if now - at <= RATE_SECONDS]
        snapshot = RunSnapshot(
            settings=self._settings,
            state=self._figures.state(self._ending),
            metrics=self._metrics,
            evaluations=self._evaluations,
            present=frozenset({("learner", "learner"), ("actor", NAME), ("evaluator", "evaluator")}),
            steps_per_second=self._rate(),
        )
        self._display.show(snapshot, self._where_to_look)

    def _rate(self) -> float | None:
        (first_at, first), (last_at, last) = self._progress[0], self._progress[-1]
        return (last - first) / (last_at - first_at) if last_at - first_at >= 2.0 else None
