"""Limits of what others report: names and values come from other processes, and end in files on the disk."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from athrl_protocol import MetricsReport
from athrl_protocol.monitoring.families import Reader
from athrl_protocol.monitoring.table import ACTOR

REPORTS_A_SECOND = 2.0
"""Of a service that are written; each reports once a second."""

MOST_AT_ONCE = 60
"""Of a service: reports wait until the run's state is known."""

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
        # How many more reports of each service are written, and since when; in the order of time.
        self._left: dict[tuple[str, str], tuple[float, float]] = {}
        self._actors = Reader(ACTOR)

    def admitted(self, report: MetricsReport) -> Mapping[str, float]:
        """Return the values of a report that are written; of an actor only those that the table has."""
        if not self._takes_one((report.role, report.name)):
            return {}
        if report.role != "actor":
            return report.values
        known = [name for name in report.values if self._actors.knows(name)]
        return {name: report.values[name] for name in known[:MOST_VALUES]}

    def _takes_one(self, service: tuple[str, str]) -> bool:
        """Whether one more report of a service is written; counts it."""
        now = self._clock()
        while self._left and now - next(iter(self._left.values()))[1] > _FORGOTTEN_AFTER:
            del self._left[next(iter(self._left))]
        if service not in self._left and len(self._left) >= MOST_SERVICES:
            return False
        left, since = self._left.pop(service, (float(MOST_AT_ONCE), now))
        left = min(MOST_AT_ONCE, left + (now - since) * REPORTS_A_SECOND)
        self._left[service] = (left - 1.0 if left >= 1.0 else left, now)
        return left >= 1.0
