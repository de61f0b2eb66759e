"""Work in threads and in Zenoh's callbacks, whose failures are raised to callers that wait for it.

A thread that ends by an exception ends silently, and a caller that waits for its result would wait forever.
"""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from athrl_protocol.errors import BackgroundFailed
from athrl_protocol.faults.bounded_log import BoundedLog


class Background:
    """Keeps the first failure of some work and raises it where results are requested.

    Args:
        what: names the work in one or two words.
        log: gets every failure, in one line.
        wake: called after a failure, to wake waiting callers.
    """

    def __init__(self, what: str, log: logging.Logger, wake: Callable[[], None] = lambda: None) -> None:
        self._what = what
        self._log = log
        self._say = BoundedLog(log.error)
        self._wake = wake
        self._lock = threading.Lock()
        self._failure: BaseException | None = None

    @property
    def failed(self) -> bool:
        """Whether some of the work ended by an exception."""
        return self._failure is not None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Do work inside the block; its exceptions are kept and not raised."""
        try:
            yield
        except BaseException as error:  # a panic inside Zenoh is not an Exception
            with self._lock:
                self._failure = self._failure or error
            self._say(f"{self._what} failed: {_in_one_line(error)}")
            self._log.debug("%s failed", self._what, exc_info=error)
            self._wake()

    def check(self) -> None:
        """Raise BackgroundFailed if some of the work failed."""
        if self._failure is not None:
            raise BackgroundFailed(f"{self._what} failed: {_in_one_line(self._failure)}") from self._failure


def _in_one_line(error: BaseException) -> str:
    """Return the exception and its position."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return " ".join(f"{type(error).__name__}: {error}{place}".split())
