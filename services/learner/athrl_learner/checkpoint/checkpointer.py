"""When checkpoints are written, and the thread that writes them while training continues."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path

from athrl_spaces.wording import system_reason

from athrl_learner.checkpoint import BestCheckpoint, CheckpointContent, remove_unneeded, write_checkpoint
from athrl_learner.errors import CheckpointFailed, LogFailed
from athrl_learner.files import Files
from athrl_learner.log import SegmentLog, needed_segments

log = logging.getLogger(__name__)

#: Seconds for one checkpoint after which the disk is considered stuck when the run ends.
LONGEST_WRITE = 120.0


class Checkpointer:
    """Writes checkpoints one at a time, and removes files that no kept checkpoint needs."""

    def __init__(
        self,
        folder: Path,
        experience: SegmentLog,
        best: BestCheckpoint,
        *,
        seconds: float,
        kept: int,
        files: Files | None = None,
        warn: Callable[[str], object] = log.warning,
    ) -> None:
        """`warn` is called with a text when the disk fails and training continues."""
        self.written = 0
        self.failed = 0
        self._folder = folder
        self._experience = experience
        self._best = best
        self._seconds = seconds
        self._kept = kept
        self._files = files or Files()
        self._warn = warn
        self._due_at = time.monotonic() + seconds
        self._writer: threading.Thread | None = None
        self._logged_best: str | None = ""  # what was logged last, to log it once

    @property
    def due(self) -> bool:
        """Whether the next regular checkpoint is due and the previous one is written."""
        busy = self._writer is not None and self._writer.is_alive()
        return not busy and time.monotonic() >= self._due_at

    def write_in_background(self, content: CheckpointContent) -> None:
        """Start writing `content`, which must share no memory with what training changes.

        A failure is logged as a warning and training continues.
        """
        self._due_at = time.monotonic() + self._seconds
        self._writer = threading.Thread(
            target=self._write_or_warn, args=(content,), name="checkpoint", daemon=True
        )
        self._writer.start()

    def write_now(self, content: CheckpointContent) -> Path:
        """Wait for the current write, then write `content`; it is on the disk when this returns.

        Raises:
            CheckpointFailed: the disk reports an error, or is stuck with the previous checkpoint.
        """
        if not self.wait():
            raise CheckpointFailed(
                f"the disk of {self._folder} did not take a checkpoint in {LONGEST_WRITE:g} s"
            )
        return self._write(content)

    def wait(self) -> bool:
        """Wait for the current write, if there is one; return whether it has ended."""
        if self._writer is None:
            return True
        self._writer.join(LONGEST_WRITE)
        return not self._writer.is_alive()

    def _write_or_warn(self, content: CheckpointContent) -> None:
        try:
            self._write(content)
        except CheckpointFailed as error:
            self.failed += 1
            self._warn(f"{error}; training continues")
        except Exception:  # a bug, or lack of memory: nobody would notice that the thread has ended
            self.failed += 1
            log.exception("a checkpoint was not written; training continues")

    def _write(self, content: CheckpointContent) -> Path:
        began = time.monotonic()
        try:
            self._experience.sync()  # segments first: a manifest must only name what is on the disk
        except LogFailed as error:
            raise CheckpointFailed(str(error)) from None
        path = write_checkpoint(self._folder, content, self._files)
        self.written += 1
        log.info("checkpoint %s written in %.1f s", path, time.monotonic() - began)
        self._remove_unneeded()
        return path

    def _remove_unneeded(self) -> None:
        """Remove what no kept checkpoint needs; what cannot be removed only costs space."""
        try:
            kept = remove_unneeded(self._folder, self._kept, self._best, self._files)
            needed = needed_segments(kept.newest, kept.others)
            self._experience.keep_only(needed.oldest, needed.named)
        except OSError as error:
            self._warn(f"cannot clear {self._folder} of old checkpoints: {system_reason(error)}")
            return
        if kept.best != self._logged_best:
            self._logged_best = kept.best
            log.info(
                "the best checkpoint by the evaluator's scores is %s",
                kept.best or "not known: no score was received",
            )
