"""One line a minute in the actor's log: how much it has driven and sent, and how well."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping

log = logging.getLogger(__name__)

INTERVAL = 60.0
"""Seconds between two lines."""


class ProgressLog:
    """Logs the metrics that matter to an operator."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._told_at = clock()

    def report(self, metrics: Mapping[str, float]) -> None:
        """Log a line if a minute has passed since the last one; called with each report of metrics."""
        now = self._clock()
        if now - self._told_at >= INTERVAL:
            self._told_at = now
            log.info("%s", progress_line(metrics))


def progress_line(metrics: Mapping[str, float]) -> str:
    """The progress in one line; what is not known yet is left out."""
    parts = [f"{metrics['decisions']:.0f} decisions ({metrics['decisions_per_second']:.0f}/s)"]
    if "policy_version" in metrics:
        parts.append(f"policy {metrics['policy_version']:.0f}")
    if "return_mean" in metrics:
        parts.append(f"return {metrics['return_mean']:.0f}, collisions {metrics['collision_rate']:.0%}")
    parts.append(f"{metrics['chunks_acknowledged']:.0f} chunks stored, {metrics['chunks_waiting']:.0f} wait")
    return ", ".join(parts)
