"""For how long the learner has acknowledged no chunk, to be logged once while an actor waits for it."""

from __future__ import annotations

import time
from collections.abc import Callable


class AcknowledgementWatch:
    """Measures the time since it was made, or since the learner last acknowledged a chunk."""

    def __init__(
        self, patience: float, acknowledged: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._patience = patience
        self._acknowledged = acknowledged
        self._clock = clock
        self._since = clock()
        self._reported = False

    def overdue_seconds(self, acknowledged: int) -> float | None:
        """Return the seconds that have passed once they exceed the patience; None before and afterwards."""
        now = self._clock()
        if acknowledged != self._acknowledged:
            self._acknowledged, self._since, self._reported = acknowledged, now, False
        if self._reported or now - self._since <= self._patience:
            return None
        self._reported = True
        return now - self._since
