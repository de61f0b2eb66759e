"""The run's disk: a small separate one that can be filled and emptied."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Self

ROOM_BYTES = 2 * 2**30
"""More than a run writes; unused space takes no memory."""
_PATIENCE_SECONDS = 20.0


class Disk:
    """A file system in memory at `folder`, or the folder itself if mounting is not permitted.

    A context manager; afterwards nothing is mounted, and the contents are in `folder` if `kept`.

    Attributes:
        permitted: whether it could be mounted, so that it can get full.
    """

    def __init__(self, folder: Path, *, kept: bool) -> None:
        self.folder = folder
        self.permitted = False
        self._kept = kept

    def __enter__(self) -> Self:
        self.folder.mkdir(parents=True)
        self.permitted = self._mount(f"size={ROOM_BYTES}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self.permitted:
            return
        copy = self.folder.with_name(f"{self.folder.name}.copy")
        try:
            if self._kept:
                shutil.copytree(self.folder, copy)
        finally:
            # Lazily, so that a process that still uses it does not keep it mounted.
            subprocess.run(["umount", "--lazy", self.folder], check=True)
        if self._kept:
            self.folder.rmdir()
            copy.rename(self.folder)

    def fill(self, free_bytes: int) -> None:
        """Leave so much free space, now and until `empty`."""
        deadline = time.monotonic() + _PATIENCE_SECONDS
        while not self._mount(f"remount,size={self._used_bytes() + free_bytes}"):
            # A process has written since the space was measured; a disk cannot be smaller than its content.
            if time.monotonic() > deadline:
                raise TimeoutError(f"{self.folder} could not be made full")

    def empty(self) -> None:
        """Free the space again."""
        if not self._mount(f"remount,size={ROOM_BYTES}"):
            raise OSError(f"{self.folder} could not be emptied")

    def _used_bytes(self) -> int:
        state = os.statvfs(self.folder)
        return (state.f_blocks - state.f_bfree) * state.f_frsize

    def _mount(self, options: str) -> bool:
        mount = shutil.which("mount") or "false"
        command = [mount, "-t", "tmpfs", "-o", options, "tmpfs", str(self.folder)]
        return subprocess.run(command, capture_output=True).returncode == 0
