"""One update after another, and what they cost and say."""

from __future__ import annotations

import time
from collections import defaultdict

from athrl_planners import AtHRL, SequenceBatch


class Trainer:
    """Updates the agent and averages what the updates report between two reports."""

    def __init__(self, agent: AtHRL) -> None:
        self._agent = agent
        self._sums: defaultdict[str, float] = defaultdict(float)
        self._counts: defaultdict[str, int] = defaultdict(int)
        self._seconds = 0.0

    @property
    def updates(self) -> int:
        """Updates since the run began, those before a resume included."""
        return self._agent.updates

    def update(self, batch: SequenceBatch) -> None:
        """Train on a batch."""
        began = time.monotonic()
        for name, value in self._agent.update(batch).items():
            self._sums[name] += value
            self._counts[name] += 1
        self._seconds += time.monotonic() - began

    def metrics(self) -> dict[str, float]:
        """Means since the last call: `loss/...` as the planner names them, and seconds spent in updates."""
        values = {f"loss/{name}": total / self._counts[name] for name, total in self._sums.items()}
        values["update_seconds"] = self._seconds
        self._sums.clear()
        self._counts.clear()
        self._seconds = 0.0
        return values
