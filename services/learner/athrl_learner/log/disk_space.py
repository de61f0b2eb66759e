"""Whether the disk has space for arriving chunks, since when it is full, and how often that is logged."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from athrl_protocol.faults.bounded_log import RareLog

log = logging.getLogger(__name__)

#: Refused actors ask again many times a second; after so long without a request, none is waiting.
_STALE_SECONDS = 5.0


def disk_warnings() -> RareLog:
    """Logs one warning a minute at most: on a full disk every file of a learner fails again and again."""
    return RareLog(log.warning)


class DiskSpace:
    """Logs that intake pauses, and that it continues after a pause that was logged. Not thread-safe.

    Args:
        warn: logs a text or leaves it out, and returns whether it was logged.
        clock: gives the time, seconds.
    """

    def __init__(
        self, warn: Callable[[str], bool] | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._warn = warn or disk_warnings()
        self._told = False
        self._clock = clock
        self._reason = ""
        self._since = 0.0
        self._refused_at = 0.0

    def report_full(self, reason: str) -> None:
        """A record could not be written because the disk is full."""
        self._refused_at = self._clock()
        if not self._reason:
            self._since = self._refused_at
        self._reason = reason
        self._told = self._told or self._warn(f"intake pauses, nothing is lost: {reason}")

    def report_free(self) -> None:
        """A record was written."""
        if self._told:
            log.warning("intake continues after %.0f s: there is space again", self._clock() - self._since)
        self._reason, self._told = "", False

    def explain(self) -> str:
        """Why actors have to wait, and for how long they have waited; empty while there is space."""
        now = self._clock()
        if not self._reason or now - self._refused_at > _STALE_SECONDS:
            return ""
        return f"intake is paused for {now - self._since:.0f} s: {self._reason}"
