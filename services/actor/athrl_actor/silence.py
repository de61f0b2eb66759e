"""For how long the learner has taken nothing, to be told once while an actor waits for it."""

from __future__ import annotations

import time
from collections.abc import Callable


class Silence:
    """Begins when it is made, and anew with each chunk that the learner has acknowledged."""

    def __init__(
        self, patience: float, acknowledged: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._patience = patience
        self._acknowledged = acknowledged
        self._clock = clock
        self._began = clock()
        self._told = False

    def worth_telling(self, acknowledged: int) -> float | None:
        """Return its seconds once it has lasted for longer than the patience; None before and afterwards."""
        now = self._clock()
        if acknowledged != self._acknowledged:
            self._acknowledged, self._began, self._told = acknowledged, now, False
        if self._told or now - self._began <= self._patience:
            return None
        self._told = True
        return now - self._began
