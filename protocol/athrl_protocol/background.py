"""Work behind somebody's back, in threads and in Zenoh's callbacks: its failures reach whoever waits for it.

A thread that ends by an exception ends in silence, and who waits for what it brings would wait for ever.
"""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from athrl_protocol.bounded_log import BoundedLog
from athrl_protocol.errors import BackgroundFailed


class Background:
    """Keeps the first failure of some work and raises it where its results are asked for.

    Args:
        what: names the work in one or two words.
        log: told of every failure, in one line.
        wake: called after a failure; wakes those who wait.
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
        """Do work inside the block; whatever it raises is kept and goes no further."""
        try:
            yield
        except BaseException as error:  # a panic inside of Zenoh is no Exception
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
    """Return what was raised and where."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return " ".join(f"{type(error).__name__}: {error}{place}".split())
