"""Runs updates, and measures their time and metrics."""

from __future__ import annotations

import time
from collections import defaultdict

import numpy as np
import torch
from athrl_planners import Agent, Batch, SequenceReplay, TrainingDiverged
from numpy.typing import NDArray

_MUST_BE_FINITE = ("loss", "gradient")


class Trainer:
    """Updates the agent and averages the metrics of the updates between two reports."""

    def __init__(self, agent: Agent, replay: SequenceReplay) -> None:
        self._agent, self._replay = agent, replay
        self._sums: dict[str, torch.Tensor] = {}
        self._counts: defaultdict[str, int] = defaultdict(int)
        self._seconds = 0.0
        self._trained = 0
        self._diverged = ""  # what was not finite, if anything was
        self.batch: Batch | None = None
        """The last batch, to be saved if training diverges."""

    @property
    def updates(self) -> int:
        """Updates since the run began, those before a resume included."""
        return self._agent.updates

    def update(self, batch: Batch, progress: float) -> None:
        """Train on a batch; `progress` is the share of the run that is over, 0 to 1.

        Raises:
            TrainingDiverged: a loss, a gradient, or an error that would be a priority is not finite. On a GPU
                losses and gradients are not checked here, see `require_finite`.
        """
        began = time.monotonic()
        self.batch = batch
        metrics, errors = self._agent.update(batch, progress)
        if self._replay.prioritised:
            self._replay.update_priorities(batch, self._finite(errors.cpu().numpy()))
        # Sums stay on the device until they are read, so that nothing waits for it here.
        for name, value in metrics.items():
            self._sums[name] = self._sums[name] + value if name in self._sums else value
            self._counts[name] += 1
        self._trained += batch.transitions
        self._seconds += time.monotonic() - began
        if self._agent.device.type == "cpu":
            self.require_finite()

    def _finite(self, errors: NDArray[np.float32]) -> NDArray[np.float32]:
        """Check the errors of a batch: with one that is not finite nothing can be sampled any more."""
        wrong = errors[~np.isfinite(errors)]
        if wrong.size:
            raise TrainingDiverged(f"an error of update {self.updates} is {wrong[0]:g}")
        return errors

    def require_finite(self) -> None:
        """Check losses and gradients; waits for the work of a GPU.

        If a gradient is not finite, the weights are not either, so this is called before anything that saves
        or publishes them.

        Raises:
            TrainingDiverged: one of them was not finite since the learner started.
        """
        self._check_sums()
        if self._diverged:
            raise TrainingDiverged(self._diverged)

    def _check_sums(self) -> None:
        for name, total in self._sums.items():
            if not self._diverged and name.endswith(_MUST_BE_FINITE) and not torch.isfinite(total):
                self._diverged = f"{name} up to update {self.updates} is {float(total):g}"

    def metrics(self) -> dict[str, float]:
        """Means since the last call: `loss/...` as the planner names them, and the time of updates.

        `update_seconds` are the seconds spent, `trained_per_second` the decisions trained per second of them.
        """
        self._check_sums()  # before the sums are cleared
        values = {f"loss/{name}": float(total) / self._counts[name] for name, total in self._sums.items()}
        values["update_seconds"] = self._seconds
        values["trained_per_second"] = self._trained / self._seconds if self._seconds else 0.0
        self._sums.clear()
        self._counts.clear()
        self._seconds, self._trained = 0.0, 0
        return values
