"""One update after another, and what they cost and say."""

from __future__ import annotations

import time
from collections import defaultdict

import torch
from athrl_planners import Agent, Batch, SequenceReplay, TrainingDiverged

_MUST_BE_FINITE = ("loss", "gradient")


class Trainer:
    """Updates the agent and averages what the updates report between two reports."""

    def __init__(self, agent: Agent, replay: SequenceReplay) -> None:
        self._agent, self._replay = agent, replay
        self._sums: dict[str, torch.Tensor] = {}
        self._counts: defaultdict[str, int] = defaultdict(int)
        self._seconds = 0.0
        self._trained = 0
        self._diverged = ""  # what was not finite, once something was
        self.batch: Batch | None = None
        """What was trained on last, for a look when training has diverged."""

    @property
    def updates(self) -> int:
        """Updates since the run began, those before a resume included."""
        return self._agent.updates

    def update(self, batch: Batch, progress: float) -> None:
        """Train on a batch; `progress` is the share of the run that is over, 0 to 1.

        Raises:
            TrainingDiverged: a loss or a gradient is not finite. On a GPU nobody looks here, see
                `require_finite`.
        """
        began = time.monotonic()
        self.batch = batch
        metrics, errors = self._agent.update(batch, progress)
        if self._replay.prioritised:
            self._replay.learnt(batch, errors.cpu().numpy())
        # Nobody waits for a device here: sums stay where they are until somebody wants to know them.
        for name, value in metrics.items():
            self._sums[name] = self._sums[name] + value if name in self._sums else value
            self._counts[name] += 1
        self._trained += batch.transitions
        self._seconds += time.monotonic() - began
        if self._agent.device.type == "cpu":
            self.require_finite()

    def require_finite(self) -> None:
        """Look at losses and gradients, for which a GPU's work is waited for.

        With a gradient that is not finite the weights are not either, so this comes before everything that
        keeps or publishes them.

        Raises:
            TrainingDiverged: one of them was not finite since the learner started.
        """
        self._look()
        if self._diverged:
            raise TrainingDiverged(self._diverged)

    def _look(self) -> None:
        for name, total in self._sums.items():
            if not self._diverged and name.endswith(_MUST_BE_FINITE) and not torch.isfinite(total):
                self._diverged = f"{name} up to update {self.updates} is {float(total):g}"

    def metrics(self) -> dict[str, float]:
        """Means since the last call: `loss/...` as the planner names them; and seconds spent, and on what.

        These are `update_seconds`, and `trained_per_second`, decisions trained in a second of them.
        """
        self._look()  # before it is forgotten here
        values = {f"loss/{name}": float(total) / self._counts[name] for name, total in self._sums.items()}
        values["update_seconds"] = self._seconds
        values["trained_per_second"] = self._trained / self._seconds if self._seconds else 0.0
        self._sums.clear()
        self._counts.clear()
        self._seconds, self._trained = 0.0, 0
        return values
