"""Whether the disk has room for what arrives, and since when it has not."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

log = logging.getLogger(__name__)

#: Actors that are refused ask again many times a second; when nobody did for so long, nobody is waiting.
_STALE_SECONDS = 5.0


class DiskRoom:
    """Says once that intake pauses and once that it goes on. Not thread-safe: the store's lock guards it."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._reason = ""
        self._since = 0.0
        self._refused_at = 0.0

    def missing(self, reason: str) -> None:
        """Something could not be written down for want of room."""
        self._refused_at = self._clock()
        if not self._reason:
            self._since = self._refused_at
            log.warning("intake pauses, nothing is lost: %s", reason)
        self._reason = reason

    def found(self) -> None:
        """Something was written down."""
        if self._reason:
            log.warning("intake goes on after %.0f s: there is room again", self._clock() - self._since)
            self._reason = ""

    def explain(self) -> str:
        """Why actors have to wait, and for how long they already have; empty while there is room."""
        now = self._clock()
        if not self._reason or now - self._refused_at > _STALE_SECONDS:
            return ""
        return f"intake is paused for {now - self._since:.0f} s: {self._reason}"
