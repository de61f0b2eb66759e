"""The disk operations that log and checkpoints use for writing.

All of them go through this module, so that a test can let each one fail, or end the process after it.
Reading is not included: it changes nothing.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from pathlib import Path

#: Errors of a full disk: no space, or the user's quota is used up.
NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


class WritableFile:
    """An append-only file; unbuffered, so that what was written survives the process."""

    def __init__(self, path: Path) -> None:
        """Create the file at `path`, empty; raises OSError."""
        self._descriptor = os.open(
            path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC, 0o644
        )

    def write(self, content: bytes | memoryview) -> None:
        """Append all of `content`; raises OSError, and then a part of it may have been written."""
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]

    def truncate(self, size: int) -> None:
        """Keep the first `size` bytes; raises OSError."""
        os.ftruncate(self._descriptor, size)

    def sync(self) -> None:
        """Sync the file to the disk; raises OSError."""
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


class Files:
    """Files and folders of the disk; all methods raise OSError."""

    def create(self, path: Path) -> WritableFile:
        """Create or replace the file at `path`."""
        return WritableFile(path)

    def truncate(self, path: Path, size: int) -> None:
        """Keep the first `size` bytes of a file, and sync that to the disk."""
        descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.ftruncate(descriptor, size)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def make_folder(self, path: Path) -> None:
        """Make a folder and its parents if they are missing."""
        path.mkdir(parents=True, exist_ok=True)

    def rename(self, old: Path, new: Path) -> None:
        """Rename a file or folder; an existing file of the new name is replaced."""
        old.replace(new)

    def remove(self, path: Path) -> None:
        """Remove a file; a missing one is no error."""
        path.unlink(missing_ok=True)

    def remove_folder(self, path: Path) -> None:
        """Remove a folder with its contents, as far as possible."""
        shutil.rmtree(path, ignore_errors=True)

    def sync_folder(self, path: Path) -> None:
        """Sync the folder's list of names to the disk."""
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def free_bytes(self, path: Path) -> int:
        """Free space for this user on the disk of `path`, in bytes."""
        facts = os.statvfs(path)
        return facts.f_bavail * facts.f_frsize


def write_whole(files: Files, path: Path, content: bytes) -> None:
    """Write another file, sync it to the disk and rename it to `path`: readers see the old or the new file.

    Raises:
        OSError: the disk reports an error; `path` is unchanged.
    """
    part = path.with_name(path.name + ".part")
    try:
        with contextlib.closing(files.create(part)) as file:
            file.write(content)
            file.sync()
        files.rename(part, path)
    except OSError:
        with contextlib.suppress(OSError):
            files.remove(part)
        raise
