"""When checkpoints are written, and the thread that writes them while training goes on."""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path

from athrl_learner.checkpoint import CheckpointContent, write_checkpoint
from athrl_learner.errors import CheckpointFailed

log = logging.getLogger(__name__)

#: A disk that takes longer than this for one checkpoint is taken for stuck when the run ends.
LONGEST_WRITE = 120.0


class Checkpointer:
    """Writes checkpoints one at a time; a regular one that fails is a warning, the last one an error."""

    def __init__(self, folder: Path, seconds: float, kept: int) -> None:
        self.written = 0
        self.failed = 0
        self._folder = folder
        self._seconds = seconds
        self._kept = kept
        self._due_at = time.monotonic() + seconds
        self._writer: threading.Thread | None = None

    @property
    def due(self) -> bool:
        """Whether it is time for the next regular checkpoint and the one before is written."""
        busy = self._writer is not None and self._writer.is_alive()
        return not busy and time.monotonic() >= self._due_at

    def write_in_background(self, content: CheckpointContent) -> None:
        """Start writing `content`, which must share no memory with what training changes."""
        self._due_at = time.monotonic() + self._seconds
        self._writer = threading.Thread(target=self._try, args=(content,), name="checkpoint", daemon=True)
        self._writer.start()

    def write_last(self, content: CheckpointContent) -> Path:
        """Wait for the writing under way, then write `content`.

        Raises:
            CheckpointFailed: the disk refuses, or is stuck with the one before.
        """
        if self._writer is not None:
            self._writer.join(LONGEST_WRITE)
            if self._writer.is_alive():
                raise CheckpointFailed(
                    f"the disk of {self._folder} did not take a checkpoint in {LONGEST_WRITE:g} s"
                )
        return self._write(content)

    def _try(self, content: CheckpointContent) -> None:
        try:
            self._write(content)
        except CheckpointFailed as error:
            self.failed += 1
            log.warning("%s; training goes on", error)

    def _write(self, content: CheckpointContent) -> Path:
        began = time.monotonic()
        path = write_checkpoint(self._folder, content, self._kept)
        self.written += 1
        log.info("checkpoint %s written in %.1f s", path, time.monotonic() - began)
        return path
