"""Limits of what others report: names and values come from other processes, and end in files on the disk."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from athrl_protocol import MetricsReport
from athrl_protocol.monitoring.families import Reader
from athrl_protocol.monitoring.table import ACTOR

LEAST_SECONDS = 0.5
"""Between two reports of a service that are written; each reports once a second."""

MOST_SERVICES = 20_000
"""Whose reports are written; a name is forgotten after a minute without a report."""

MOST_VALUES = 100
"""Of an actor's report; it has some twenty, and two for each town."""

_FORGOTTEN_AFTER = 60.0


class ReportLimits:
    """Decides what of the services' reports is written.

    Args:
        clock: seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._written_at: dict[tuple[str, str], float] = {}  # in the order of time
        self._actors = Reader(ACTOR)

    def admitted(self, report: MetricsReport) -> Mapping[str, float]:
        """Return the values of a report that are written; of an actor only those that the table has."""
        now, who = self._clock(), (report.role, report.name)
        if now - self._written_at.get(who, -LEAST_SECONDS) < LEAST_SECONDS:
            return {}
        self._forget_before(now - _FORGOTTEN_AFTER)
        if who not in self._written_at and len(self._written_at) >= MOST_SERVICES:
            return {}
        self._written_at.pop(who, None)
        self._written_at[who] = now
        if report.role != "actor":
            return report.values
        known = [name for name in report.values if self._actors.knows(name)]
        return {name: report.values[name] for name in known[:MOST_VALUES]}

    def _forget_before(self, moment: float) -> None:
        while self._written_at and next(iter(self._written_at.values())) < moment:
            del self._written_at[next(iter(self._written_at))]
