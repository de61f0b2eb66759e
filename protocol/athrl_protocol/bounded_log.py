"""Lines in a log about what others do: one for each thing, whatever they send and however often."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

LONGEST_TEXT = 200


def shortened(text: str) -> str:
    """Return what somebody else wrote in quotes, as one line of bearable length."""
    return repr(text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]}...")


class BoundedLog:
    """Logs a line again only after `seconds`, and at most `lines` different ones in that time."""

    def __init__(
        self,
        write: Callable[[str], None],
        seconds: float = 10.0,
        lines: int = 20,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._write = write
        self._seconds = seconds
        self._lines = lines
        self._clock = clock
        self._began = -float("inf")
        self._counts: dict[str, int] = {}
        self._beyond = 0
        self._lock = threading.Lock()

    def __call__(self, text: str) -> None:
        """Log the line, or count it."""
        with self._lock:
            if self._clock() - self._began >= self._seconds:
                self._sum_up()
            if text in self._counts:
                self._counts[text] += 1
            elif len(self._counts) < self._lines:
                self._counts[text] = 1
                self._write(text)
            else:
                self._beyond += 1

    def _sum_up(self) -> None:
        """Say how often each line would have come since it was logged, and begin anew."""
        for text, count in self._counts.items():
            if count > 1:
                self._write(f"{text} ({count - 1} times more)")
        if self._beyond:
            self._write(f"{self._beyond} other messages were refused as well")
        self._counts, self._beyond, self._began = {}, 0, self._clock()
