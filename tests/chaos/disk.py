"""The run's disk: a small one of its own, which gets full and has room again."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Self

ROOM_BYTES = 2 * 2**30
"""More than a storm writes; what is not written takes no memory."""
_PATIENCE_SECONDS = 20.0


class Disk:
    """A file system in memory at `folder`, or that folder as it is where mounting is not permitted.

    A context manager; afterwards nothing is mounted, and what was on the disk lies in `folder` if `kept`.

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
            # Lazily, so that nobody who still looks into it keeps it mounted.
            subprocess.run(["umount", "--lazy", self.folder], check=True)
        if self._kept:
            self.folder.rmdir()
            copy.rename(self.folder)

    def fill(self, free_bytes: int) -> None:
        """Leave so much room, now and until `empty`."""
        deadline = time.monotonic() + _PATIENCE_SECONDS
        while not self._mount(f"remount,size={self._used_bytes() + free_bytes}"):
            # Somebody has written since the room was looked at; no disk is smaller than what is on it.
            if time.monotonic() > deadline:
                raise TimeoutError(f"{self.folder} could not be made full")

    def empty(self) -> None:
        """Have room again."""
        if not self._mount(f"remount,size={ROOM_BYTES}"):
            raise OSError(f"{self.folder} could not be given room again")

    def _used_bytes(self) -> int:
        state = os.statvfs(self.folder)
        return (state.f_blocks - state.f_bfree) * state.f_frsize

    def _mount(self, options: str) -> bool:
        mount = shutil.which("mount") or "false"
        command = [mount, "-t", "tmpfs", "-o", options, "tmpfs", str(self.folder)]
        return subprocess.run(command, capture_output=True).returncode == 0
