"""Bounded logging: of what other processes send, and of what is noticed again and again."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

LONGEST_TEXT = 200
SECONDS = 10.0  # after which `BoundedLog` logs a line again
LINES = 20  # different ones that it logs in that time
RARE_SECONDS = 60.0  # between two lines of `RareLog`
MOST_OTHERS = 3  # texts that a line of `RareLog` has besides its own


def shortened(text: str) -> str:
    """Return a text of another process in quotes, as one line of limited length."""
    return repr(text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]}...")


class BoundedLog:
    """Logs a line again only after `SECONDS`, and at most `LINES` different ones in that time."""

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._write = write
        self._clock = clock
        self._began = -float("inf")
        self._counts: dict[str, int] = {}
        self._beyond = 0
        self._lock = threading.Lock()

    def __call__(self, text: str) -> None:
        """Log the line, or count it."""
        with self._lock:
            if self._clock() - self._began >= SECONDS:
                self._sum_up()
            if text in self._counts:
                self._counts[text] += 1
            elif len(self._counts) < LINES:
                self._counts[text] = 1
                self._write(text)
            else:
                self._beyond += 1

    def _sum_up(self) -> None:
        """Log how often each line was suppressed since it was logged, and start again."""
        for text, count in self._counts.items():
            if count > 1:
                self._write(f"{text} ({count - 1} times more)")
        if self._beyond:
            self._write(f"{self._beyond} other lines were left out")
        self._counts, self._beyond, self._began = {}, 0, self._clock()


class RareLog:
    """Logs at most one line in `RARE_SECONDS`; it also has what else was to be logged since the line before.

    For a condition that several places notice again and again, such as a full disk.
    """

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._write = write
        self._clock = clock
        self._wrote_at = -float("inf")
        self._left_out: dict[str, None] = {}
        self._lock = threading.Lock()

    def __call__(self, text: str) -> bool:
        """Log the text or leave it out; return whether it was logged."""
        with self._lock:
            now = self._clock()
            if now - self._wrote_at < RARE_SECONDS:
                if len(self._left_out) < MOST_OTHERS:
                    self._left_out[text] = None
                return False
            self._left_out.pop(text, None)
            others = f" (before that: {'; '.join(self._left_out)})" if self._left_out else ""
            self._wrote_at, self._left_out = now, {}
        self._write(text + others)
        return True
