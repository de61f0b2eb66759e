"""Syncs the log to the disk at an interval, in a thread, because a disk may be slow."""

from __future__ import annotations

import logging
import threading
from types import TracebackType
from typing import Self

from athrl_learner.errors import LogFailed
from athrl_learner.log.writing import SegmentLog

log = logging.getLogger(__name__)

_JOIN_SECONDS = 30.0


class IntervalSync:
    """Calls `SegmentLog.sync` every `seconds` while the context lasts.

    An error of the disk is raised by the next `append`.
    """

    def __init__(self, experience: SegmentLog, seconds: float) -> None:
        self._experience = experience
        self._seconds = seconds
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log-sync", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join(_JOIN_SECONDS)

    def _run(self) -> None:
        while not self._stop.wait(self._seconds):
            try:
                self._experience.sync()
            except LogFailed as error:
                log.error("%s", error)
                return
