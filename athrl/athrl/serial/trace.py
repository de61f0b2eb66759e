"""`trace.txt`: fingerprints along the run, without times, so that `diff` compares two runs.

    update 200, step 1480: parameters 3f9ab0c1d2e3f405
    update 2400, step 13220: parameters ... optimisers ... replay ... actor ...

A line of the second kind is written at every regular checkpoint and at the end. A checkpoint knows how long
the file was; what a killed run wrote behind it is cut off on resume, and written again.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path

from athrl_learner import CannotResume

log = logging.getLogger(__name__)


def cut_back(path: Path, size: int) -> None:
    """Cut off what was written behind the first `size` bytes of a file, if there is any.

    Raises:
        CannotResume: the file cannot be changed.
    """
    try:
        if path.exists() and path.stat().st_size > size:
            os.truncate(path, size)
    except OSError as error:
        raise CannotResume(f"cannot cut off the end of {path}: {error.strerror}") from None


def size_of(path: Path) -> int:
    """Bytes in a file; 0 where there is none."""
    return path.stat().st_size if path.exists() else 0


class Trace:
    """Writes lines that are on their way to the disk when `add` returns, and into the log as well."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def add(self, line: str) -> None:
        """Write a line."""
        log.info("%s", line)
        try:
            with self.path.open("a", encoding="ascii") as stream:
                stream.write(line + "\n")
        except OSError as error:
            log.warning("cannot write %s: %s", self.path, error.strerror)
