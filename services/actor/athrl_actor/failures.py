"""Counts and logs environments that raise or stall; too many of them end the actor."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable

from athrl_driving.policy import EnvironmentFailure, EnvironmentStalled
from athrl_spaces.wording import counted

WINDOW_SECONDS = 600.0  # older failures do not count, so an actor may run for weeks

log = logging.getLogger(__name__)


class ActorError(Exception):
    """An error that ends an actor; the message is one line for the user."""


class TooManyFailures(ActorError):  # noqa: N818  (the name says what happened)
    """The environments failed too often."""


class FailureCount:
    """Counts failures of the environments.

    Args:
        allowed: the most failures within `WINDOW_SECONDS` with which the actor continues.
        clock: seconds, monotonic.
    """

    def __init__(self, allowed: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._allowed = allowed
        self._clock = clock
        self._recent: deque[float] = deque()
        self._failed = 0
        self._stalled = 0
        self._chunks_dropped = 0

    def add(self, failure: EnvironmentFailure, chunks_dropped: int) -> None:
        """Count a failure that cost so many open chunks; raises TooManyFailures if the limit is exceeded."""
        if isinstance(failure, EnvironmentStalled):
            self._stalled += 1
        else:
            self._failed += 1
        self._chunks_dropped += chunks_dropped
        now = self._clock()
        self._recent.append(now)
        while self._recent[0] <= now - WINDOW_SECONDS:
            self._recent.popleft()
        if len(self._recent) > self._allowed:
            raise TooManyFailures(
                f"the environments failed {counted(len(self._recent), 'time')} within "
                f"{WINDOW_SECONDS:.0f} s, actor.failures_allowed is {self._allowed}; the last time: {failure}"
            )
        log.warning("%s; restarting %s", failure, counted(len(failure.env_indices), "episode"))

    def report(self) -> dict[str, float]:
        """The counts since the actor started."""
        return {
            "environments_failed": self._failed,
            "environments_stalled": self._stalled,
            "chunks_dropped": self._chunks_dropped,
        }
