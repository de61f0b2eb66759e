"""The rate of a count over the last minute, as services report and show it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

MINUTE = 60.0
"""Seconds over which rates are averaged: training and driving come in bursts of seconds."""


class RecentRate:
    """The rate of a growing count over the last minute, or since the first count. Not thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._noted: deque[tuple[float, float]] = deque()  # when, and the count then

    def note(self, count: float) -> None:
        """Note the present count."""
        now = self._clock()
        self._noted.append((now, count))
        while len(self._noted) > 2 and self._noted[1][0] <= now - MINUTE:
            self._noted.popleft()

    def restart(self) -> None:
        """Forget the counts so far, because from now on another rate is to be expected."""
        self._noted.clear()

    def per_second(self, least: float = 0.0) -> float | None:
        """Return the rate; None if it is over no more than `least` seconds."""
        if not self._noted:
            return None
        (first_at, first), (last_at, last) = self._noted[0], self._noted[-1]
        return (last - first) / (last_at - first_at) if last_at - first_at > least else None
