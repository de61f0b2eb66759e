"""When checkpoints are written, and the thread that writes them while training goes on."""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path

from athrl_learner.checkpoint import BestCheckpoint, CheckpointContent, remove_unneeded, write_checkpoint
from athrl_learner.errors import CheckpointFailed, LogFailed
from athrl_learner.files import Files
from athrl_learner.segments import SegmentLog, needed_segments

log = logging.getLogger(__name__)

#: A disk that takes longer than this for one checkpoint is taken for stuck when the run ends.
LONGEST_WRITE = 120.0


class Checkpointer:
    """Writes checkpoints one at a time, and clears away what no kept one needs."""

    def __init__(
        self,
        folder: Path,
        experience: SegmentLog,
        best: BestCheckpoint,
        *,
        seconds: float,
        kept: int,
        files: Files | None = None,
    ) -> None:
        self.written = 0
        self.failed = 0
        self._folder = folder
        self._experience = experience
        self._best = best
        self._seconds = seconds
        self._kept = kept
        self._files = files or Files()
        self._due_at = time.monotonic() + seconds
        self._writer: threading.Thread | None = None
        self._told_best: str | None = ""  # what was said last, to say it once

    @property
    def due(self) -> bool:
        """Whether it is time for the next regular checkpoint and the one before is written."""
        busy = self._writer is not None and self._writer.is_alive()
        return not busy and time.monotonic() >= self._due_at

    def write_in_background(self, content: CheckpointContent) -> None:
        """Start writing `content`, which must share no memory with what training changes.

        Should it fail, there is a warning and training goes on.
        """
        self._due_at = time.monotonic() + self._seconds
        self._writer = threading.Thread(target=self._try, args=(content,), name="checkpoint", daemon=True)
        self._writer.start()

    def write_now(self, content: CheckpointContent) -> Path:
        """Wait for the writing under way, then write `content`; it is on the disk when this returns.

        Raises:
            CheckpointFailed: the disk refuses, or is stuck with the one before.
        """
        if not self.wait():
            raise CheckpointFailed(
                f"the disk of {self._folder} did not take a checkpoint in {LONGEST_WRITE:g} s"
            )
        return self._write(content)

    def wait(self) -> bool:
        """Wait for the writing under way, if there is any; whether it is over."""
        if self._writer is None:
            return True
        self._writer.join(LONGEST_WRITE)
        return not self._writer.is_alive()

    def _try(self, content: CheckpointContent) -> None:
        try:
            self._write(content)
        except CheckpointFailed as error:
            self.failed += 1
            log.warning("%s; training goes on", error)

    def _write(self, content: CheckpointContent) -> Path:
        began = time.monotonic()
        try:
            self._experience.sync()  # the segments first: a manifest never names what the disk does not have
        except LogFailed as error:
            raise CheckpointFailed(str(error)) from None
        path = write_checkpoint(self._folder, content, self._files)
        self.written += 1
        log.info("checkpoint %s written in %.1f s", path, time.monotonic() - began)
        self._clear_away()
        return path

    def _clear_away(self) -> None:
        """Remove what no kept checkpoint needs; what cannot be removed costs only room."""
        try:
            kept = remove_unneeded(self._folder, self._kept, self._best, self._files)
        except OSError as error:
            log.warning("cannot clear %s of old checkpoints: %s", self._folder, error.strerror)
            return
        if kept.best != self._told_best:
            self._told_best = kept.best
            log.info(
                "the best checkpoint by the evaluator's scores is %s",
                kept.best or "not known: none was heard",
            )
        needed = needed_segments(kept.newest, kept.others)
        self._experience.keep_only(needed.oldest, needed.named)
