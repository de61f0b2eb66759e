"""The operations on a disk that log and checkpoints consist of.

They go through here and nowhere else, so that a test can let each of them fail, or be the last one before
the process dies. Reading is not among them: it changes nothing.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from pathlib import Path

#: What a disk without room answers: no space, or this user's share of it used up.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


class WritableFile:
    """A file that grows at its end; unbuffered, so that what was written survives the process."""

    def __init__(self, path: Path) -> None:
        """Create the file at `path`, empty; raises OSError."""
        self._descriptor = os.open(
            path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC, 0o644
        )

    def write(self, content: bytes | memoryview) -> None:
        """Append all of `content`; raises OSError, when a part of it may be there."""
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]

    def cut(self, size: int) -> None:
        """Keep the first `size` bytes; raises OSError."""
        os.ftruncate(self._descriptor, size)

    def sync(self) -> None:
        """Return when the disk has everything; raises OSError."""
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

    def cut(self, path: Path, size: int) -> None:
        """Keep the first `size` bytes of a file, and bring that to the disk."""
        descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.ftruncate(descriptor, size)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def make_folder(self, path: Path) -> None:
        """Make a folder, and those around it, where they are missing."""
        path.mkdir(parents=True, exist_ok=True)

    def rename(self, old: Path, new: Path) -> None:
        """Give a file or folder another name; a file that had it is replaced."""
        old.replace(new)

    def remove(self, path: Path) -> None:
        """Remove a file; one that is not there is no error."""
        path.unlink(missing_ok=True)

    def remove_folder(self, path: Path) -> None:
        """Remove a folder with what is in it, as far as possible."""
        shutil.rmtree(path, ignore_errors=True)

    def sync_folder(self, path: Path) -> None:
        """Return when the disk has the folder's list of names."""
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def free_bytes(self, path: Path) -> int:
        """Room that is left on the disk of `path` for this user."""
        facts = os.statvfs(path)
        return facts.f_bavail * facts.f_frsize


def write_whole(files: Files, path: Path, content: bytes) -> None:
    """Write a file beside `path`, bring it to the disk and rename it: readers see the old or the new.

    Raises:
        OSError: the disk refuses; `path` is as it was.
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
