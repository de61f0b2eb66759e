"""Notices actors that left while the learner still needs them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from athrl_protocol.faults.bounded_log import BoundedLog

log = logging.getLogger(__name__)

#: Seconds until an absent actor counts as left: a lost connection is back sooner, and when a run is stopped
#: as a whole the learner ends before.
ABSENT_SECONDS = 5.0


class Departures:
    """Counts and logs departures, each once.

    Attributes:
        count: actors that left since this learner started; one that came back and left again counts twice.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.count = 0
        self._clock = clock
        self._warn = BoundedLog(log.warning)
        self._present: frozenset[str] = frozenset()
        self._absent_since: dict[str, float] = {}

    def update(self, present: frozenset[str]) -> None:
        """Compare with the actors that were present at the last call; called once a second."""
        now = self._clock()
        for name in self._present - present:
            self._absent_since[name] = now
        for name in present & self._absent_since.keys():
            del self._absent_since[name]
        self._present = present
        for name in [name for name, since in self._absent_since.items() if now - since >= ABSENT_SECONDS]:
            del self._absent_since[name]
            self.count += 1
            self._warn(f"actor {name} left before the end of the run; {len(present)} are present")
