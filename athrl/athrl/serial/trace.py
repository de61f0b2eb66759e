"""`trace.txt`: fingerprints of the run, without times, so that `diff` compares two runs.

    update 200, step 22784: parameters 3f9ab0c1d2e3f405
    update 2400, step 163584: parameters ... optimisers ... replay ... actor ...

A line of the second kind is written at every regular checkpoint and at the end. A checkpoint contains the
size of the file; later lines of a killed run are removed on resume and written again.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path

from athrl_learner import CannotResume
from athrl_protocol.faults.bounded_log import RareLog
from athrl_spaces.wording import system_reason

log = logging.getLogger(__name__)


def truncate_to(path: Path, size: int) -> None:
    """Truncate a file to its first `size` bytes, if it is longer.

    Raises:
        CannotResume: the file cannot be changed.
    """
    try:
        if path.exists() and path.stat().st_size > size:
            os.truncate(path, size)
    except OSError as error:
        raise CannotResume(f"cannot truncate {path}: {system_reason(error)}") from None


def size_of(path: Path) -> int:
    """Size of a file in bytes; 0 if there is none."""
    return path.stat().st_size if path.exists() else 0


class Trace:
    """Writes lines to the file, unbuffered, and to the log."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._warn = RareLog(log.warning)

    def add(self, line: str) -> None:
        """Write a line."""
        log.info("%s", line)
        try:
            with self.path.open("a", encoding="ascii") as stream:
                stream.write(line + "\n")
        except OSError as error:
            self._warn(f"cannot write {self.path}: {system_reason(error)}")
